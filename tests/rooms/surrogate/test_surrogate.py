"""Promise: what a surrogate judges worst is not trained, decided alike everywhere, and counts as no failure."""

import math
from collections import Counter
from dataclasses import replace
from fractions import Fraction
from typing import Any

import fakes
import numpy as np
import pytest
from sklearn.linear_model import Ridge
from sklearn.preprocessing import StandardScaler

from tacevo.evolution.algorithm import propose
from tacevo.evolution.development import develop
from tacevo.evolution.instructions import Effect
from tacevo.evolution.lines import CandidateLine, GenerationLine, gate_stages, skipped_note, source_hash
from tacevo.evolution.proposals import Candidate
from tacevo.evolution.state import Plan
from tacevo.evolution.surrogate import ALPHA, LEAST, SkipsWorst, features, fit, quantile
from tacevo.profile import Admitted
from tacevo.records import Rejection, Training

#: A search in which some answers are skipped, and some equal those that were trained before.
PLAN = replace(fakes.plan(generations=12), skipping=SkipsWorst(part=0.5))

Networks = list[tuple[dict[str, float], float]]


def _searched(plan: Plan, **changes: Any) -> tuple[list[CandidateLine], list[GenerationLine], list[str]]:
    """Search; return the lines of candidates and of generations, and the hashes of what was trained."""
    trained: list[str] = []

    def spying(source: str) -> Training | Rejection:
        trained.append(source_hash(source))
        return fakes.evaluate(source)

    _, recorder = fakes.search(plan, evaluate=spying, **changes)
    lines = [line for line in recorder.lines if isinstance(line, CandidateLine)]
    return lines, [line for line in recorder.lines if isinstance(line, GenerationLine)], trained


def _networks(rng: np.random.Generator, count: int = 40) -> Networks:
    """Draw features, some of them lacking, constant or of another scale, and fitnesses."""
    scales = {"a": 1.0, "b": 1e-3, "c": 37.0, "d": 5.0}
    return [
        (
            {name: scale * rng.random() for name, scale in scales.items() if rng.random() < 0.8} | {"constant": 0.1},
            0.01 + rng.random(),
        )
        for _ in range(count)
    ]


def _candidates(fitnesses: list[float]) -> list[Candidate]:
    """Return trained networks whose fitness follows from how many parameters they have."""
    return [
        Candidate(
            id=f"g00s{number:02d}",
            source=f"class Net: number = {number}",
            fitness=fitness,
            curiosities=Fraction(1),
            features={"parameters": float(number)},
        )
        for number, fitness in enumerate(fitnesses)
    ]


def _admitted(parameters: int, source: str = "class Net: new = True") -> Admitted:
    admitted = fakes.inspect(source)
    assert isinstance(admitted, Admitted)
    return replace(admitted, profile=replace(admitted.profile, parameters=parameters))


def test_skipped_candidate_is_not_trained() -> None:
    """A spy counts: the sources of the other lines are trained, once a generation, and nothing else is."""
    lines, _, trained = _searched(PLAN)
    wanted = {(line.generation, line.source) for line in lines if line.source and not line.skipped}
    assert Counter(trained) == Counter(source for _, source in wanted)
    assert any(line.skipped for line in lines)


def test_line_of_a_skipped_candidate_says_what_it_is_and_of_no_failure() -> None:
    """It has source, size and descriptors, and nothing that a training, an archive or a rejection gives."""
    lines, generations, _ = _searched(PLAN)
    for line in (line for line in lines if line.skipped):
        assert None not in {line.source, line.parameters, line.flops, line.arch_div, line.request, line.answer}
        given = {line.evaluation, line.fitness, line.stage, line.reason, line.status, line.niche, line.curiosity}
        assert given == {None}
        assert line.prompt_status is None
    for ended in generations:
        own = [line for line in lines if line.generation == ended.generation]
        rejected = sum(line.stage is not None for line in own)
        assert ended.trained + (ended.skipped or 0) + rejected == len(own)
        assert ended.trainable == (len(own) - rejected) / len(own)
    count = sum(line.skipped for line in lines)
    answers = [line for line in lines if line.request is not None]
    assert gate_stages(lines)[-1].left == sum(line.stage is None for line in answers)
    assert skipped_note(lines)[0].endswith(f": {count}.")


def test_nothing_is_skipped_that_was_trained_or_before_enough_is_known() -> None:
    """The networks of earlier generations decide: equal sources are trained again, which costs nothing."""
    lines, _, _ = _searched(PLAN)
    again = 0
    for line in lines:
        known = {one.source for one in lines if one.generation < line.generation and one.fitness is not None}
        assert not line.skipped or (len(known) >= LEAST and line.source not in known)
        again += len(known) >= LEAST and line.source in known
    assert again


def test_only_answers_of_the_model_are_skipped() -> None:
    """Not the baseline, however bad the surrogate takes it to be."""
    _, recorder = fakes.search(PLAN)
    state = recorder.states[-1]
    jobs = (*propose(replace(state, generation=0), PLAN), *propose(state, PLAN))
    outcomes = develop(jobs, fakes.effects(), repairs=0, skips=lambda _: True)
    kept = [outcome.proposal for outcome in outcomes if outcome.result is not None and outcome.admitted is not None]
    assert [job.request for job in kept] == [None]


def test_skipped_answer_is_not_sent_back_and_a_repaired_one_can_be_skipped() -> None:
    """Only what the gate rejected goes back; what comes then is judged as a first answer is."""
    llm = fakes.FakeLLM()
    lines, generations, _ = _searched(replace(PLAN, repairs=2), llm=llm)
    skipped = [line for line in lines if line.skipped]
    assert {bool(line.repairs) for line in skipped} == {False, True}
    assert sum(ended.skipped or 0 for ended in generations) == sum(not line.repairs for line in skipped)
    assert llm.asked == sum(1 + len(line.repairs) for line in lines if line.request is not None)


def test_instruction_is_not_blamed_for_a_skipped_child() -> None:
    """Under `effect` the archive of prompts learns of every trained or failed child, and of no other."""
    plan = replace(PLAN, settings=replace(PLAN.settings, prompts=Effect()))
    _, recorder = fakes.search(plan, evaluate=fakes.evaluate)
    pairs = list(zip(recorder.states, recorder.states[1:], recorder.lines[1:], strict=False))
    skipped = [(before, after) for before, after, line in pairs if isinstance(line, CandidateLine) and line.skipped]
    assert skipped
    assert all(before == after for before, after in skipped)


@pytest.mark.parametrize("seed", range(5))
def test_regression_is_that_of_scikit_learn(seed: int) -> None:
    """Predictions of known and of unknown networks, with standardised features."""
    rng = np.random.default_rng(seed)
    known, unknown = _networks(rng), _networks(rng)
    names = sorted({name for row, _ in known for name in row})
    x, new = (np.array([[row.get(name, 0.0) for name in names] for row, _ in rows]) for rows in (known, unknown))
    scaler = StandardScaler().fit(x)
    scale = np.where(np.ptp(x, axis=0) > 0, scaler.scale_, np.inf)  # a constant says nothing about a network
    peer = Ridge(alpha=ALPHA).fit((x - scaler.mean_) / scale, np.log([fitness for _, fitness in known]))
    ours = fit(known)
    for rows, values in ((known, x), (unknown, new)):
        expected = peer.predict((values - scaler.mean_) / scale)
        np.testing.assert_allclose([ours.predict(row) for row, _ in rows], expected, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("part", [0.0, 0.1, 0.5, 0.77, 1.0])
@pytest.mark.parametrize("count", [1, 2, 20, 37])
def test_quantile_is_that_of_numpy(part: float, count: int) -> None:
    """Interpolated linearly; of equal values exactly that value, so that ties are not skipped."""
    values = np.random.default_rng(count).random(count).tolist()
    assert math.isclose(quantile(values, part), float(np.quantile(values, part)), rel_tol=1e-12)
    assert quantile([0.1] * count, part) == 0.1


def test_order_of_the_networks_does_not_matter() -> None:
    """Not even in the last bit."""
    rng = np.random.default_rng(0)
    networks = _networks(rng)
    first = fit(networks)
    for _ in range(10):
        shuffled = [networks[place] for place in rng.permutation(len(networks))]
        assert fit(shuffled) == first


@pytest.mark.parametrize("fitness", [0.0, 5e-324, 1e308])
def test_extreme_fitness_gives_finite_predictions(fitness: float) -> None:
    """A loss of 0 has no logarithm; one that is out after it was trained again, of infinite loss, is left out."""
    known = _candidates([fitness, math.inf, *(1.0 + number for number in range(LEAST))])
    surrogate = fit([(one.features, one.fitness) for one in known if math.isfinite(one.fitness)])
    assert math.isfinite(surrogate.predict({"parameters": 2.0**53}))
    assert math.isfinite(surrogate.predict(features(_admitted(2**53 - 1).profile)))
    SkipsWorst(part=0.5).skips(known)(_admitted(100))


def test_the_worst_part_is_skipped() -> None:
    """Where more parameters mean a higher loss: those above the quantile, not those at it, and of no tie."""
    known = _candidates([math.exp(number) for number in range(21)])
    small, large = _admitted(round(math.exp(9))), _admitted(round(math.exp(11)))
    decide = SkipsWorst(part=0.5).skips(known)
    assert (decide(small), decide(large)) == (False, True)
    assert not SkipsWorst(part=0.5).skips(known[: LEAST - 1])(large)
    assert not decide(replace(large, source=known[0].source))  # trained before
    tied = [replace(one, features={"parameters": 1.0}) for one in known]
    assert not SkipsWorst(part=0.5).skips(tied)(large)
