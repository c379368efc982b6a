"""Promise: each slot asks one of several models, by weights or by what came of their answers; the ledger says which."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import fakes
import pytest
from probabilities import agrees

from tacevo.choices import ModelChoice
from tacevo.evolution.lines import CandidateLine
from tacevo.evolution.models import Gains, draw_models, gain_of
from tacevo.records import Completion

ALIKE = (("a", 1.0), ("b", 1.0))


def chosen(gains: dict[str, Gains], slots: int, choice: ModelChoice = ModelChoice.bandit) -> list[str]:
    """Choose among two models."""
    return draw_models(ALIKE, choice, gains, seed=0, generation=1, slots=range(slots))


def lines_of(recorder: fakes.Recorder) -> list[CandidateLine]:
    """Return the lines of the candidates that a model was asked for."""
    return [line for line in recorder.lines if isinstance(line, CandidateLine) and line.request is not None]


def test_weights_are_the_shares_of_the_models() -> None:
    """Each slot draws by a stream of its own, so that it draws alike whatever slots there are beside it."""
    models = (("a", 1.0), ("b", 3.0))
    drawn = [
        draw_models(models, ModelChoice.weights, {}, seed=0, generation=generation, slots=range(60))
        for generation in range(50)
    ]
    counts = Counter(name for names in drawn for name in names)
    assert agrees(counts["b"], 0.75, 3000)
    alone = draw_models(models, ModelChoice.weights, {}, seed=0, generation=7, slots=[41])
    assert alone == [drawn[7][41]]


def test_bandit_tries_each_model_first_and_then_the_larger_bound() -> None:
    """By hand: of 4 and 16 answers, sqrt(2 ln 20 / n) is 1.224 and 0.612, so the gap of the means must be larger."""
    assert chosen({}, 2) == ["a", "b"]
    assert chosen({"a": Gains(answers=3, total=3.0)}, 1) == ["b"]
    for gap, name in ((0.5, "b"), (0.7, "a")):
        known = {"a": Gains(answers=16, total=16 * gap), "b": Gains(answers=4, total=0.0)}
        assert chosen(known, 1) == [name]
    assert chosen({"a": Gains(answers=5, total=1.0), "b": Gains(answers=5, total=1.0)}, 1) == ["a"]


def test_bandit_spreads_the_slots_of_one_generation() -> None:
    """Each slot counts as an answer of the mean gain for the slots after it; models that are alike take turns."""
    known = {name: Gains(answers=5, total=1.0) for name in "ab"}
    assert chosen(known, 6) == ["a", "b", "a", "b", "a", "b"]
    assert Counter(chosen({"a": Gains(answers=20, total=10.0), "b": Gains(answers=20, total=8.0)}, 20))["b"] > 2


@pytest.mark.parametrize(
    ("fitness", "parents", "gain"),
    [
        (0.5, [1.0], math.log(2)),
        (0.5, [1.0, 0.75], math.log(1.5)),  # of the better parent
        (1.0, [1.0], 0.0),
        (2.0, [1.0], 0.0),
        (None, [1.0], 0.0),
        (0.1, [1.0], 1.0),
        (0.0, [1.0], 1.0),
        (0.0, [0.0], 0.0),
    ],
)
def test_gain_is_how_far_a_child_is_below_its_better_parent(
    fitness: float | None, parents: list[float], gain: float
) -> None:
    """A logarithm in [0, 1], as UCB1 needs it."""
    assert gain_of(fitness, parents) == pytest.approx(gain)


@pytest.mark.parametrize("choice", ModelChoice)
def test_ledger_says_who_was_asked(choice: ModelChoice) -> None:
    """Each request asks the model of its line; a search with one model says nothing."""
    _, recorder = fakes.search(fakes.plan(generations=6, models=ALIKE, choice=choice))
    asked = {
        outcome.proposal.id: outcome.proposal.request.model
        for outcome in recorder.outcomes
        if outcome.proposal.request is not None
    }
    assert {line.id: line.model for line in lines_of(recorder)} == asked
    assert set(asked.values()) == {"a", "b"}
    _, alone = fakes.search(fakes.plan())
    assert {line.model for line in lines_of(alone)} == {None}


def test_bandit_learns_what_the_ledger_says() -> None:
    """The gains of each model, of every child that was trained or rejected, follow from the lines alone."""
    _, recorder = fakes.search(fakes.plan(generations=6, models=ALIKE, choice=ModelChoice.bandit))
    fitness = {line.id: line.fitness for line in recorder.lines if isinstance(line, CandidateLine)}
    expected = {name: Gains() for name in "ab"}
    for line in lines_of(recorder):
        gain = gain_of(line.fitness, [value for name in line.parents if (value := fitness[name]) is not None])
        expected[str(line.model)] = expected[str(line.model)].adding(gain)
    assert recorder.states[-1].gains == expected


def test_bandit_comes_to_ask_the_better_model() -> None:
    """Where one model's answers are useless."""

    class OneIsUseless(fakes.FakeLLM):
        def complete(self, requests: Sequence[Any]) -> Any:
            for position, completion in super().complete(requests):
                useless = replace(completion, text="no idea")
                yield position, useless if requests[position].model == "a" else completion

    plan = fakes.plan(generations=30, models=ALIKE, choice=ModelChoice.bandit)
    _, recorder = fakes.search(plan, llm=OneIsUseless())
    late = Counter(line.model for line in lines_of(recorder) if line.generation > 15)
    assert late["b"] > late["a"] > 0


def test_refusal_of_one_model_is_told_of_its_lines_alone() -> None:
    """A model without temperatures does not decide for the other."""

    class OneRefuses(fakes.FakeLLM):
        def complete(self, requests: Sequence[Any]) -> Any:
            for position, completion in super().complete(requests):
                yield position, self._answer(completion, requests[position].model)

        def _answer(self, completion: Completion, model: str) -> Completion:
            return replace(completion, dropped=("temperature",)) if model == "a" else completion

    _, recorder = fakes.search(fakes.plan(models=ALIKE), llm=OneRefuses())
    assert {(line.model, line.sent_temperature is None) for line in lines_of(recorder)} == {("a", True), ("b", False)}
