"""Promise: a candidate past policy and probe has a verdict within its limits, cannot forge one, and changes no other's.

One sandbox serves all of these candidates. After each of them no process is left, and a decent candidate gets the
very bits that it got before anybody else.
"""

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import fakes
import hostile_sources as sources
import numpy as np
import pytest
from hostile_runs import open_sandbox
from training_jobs import CONTRACT, RECIPE, SOURCE, examples, labelled
from waiting import eventually
from witness import living, watching_candidates

from tacevo.choices import Numerics
from tacevo.evolution.algorithm import run_search
from tacevo.gate.policy.check import rejection_of
from tacevo.profile import Admitted
from tacevo.records import Completion, Limits, Mode, Reason, Rejection, Request, Stage, Training, to_json
from tacevo.sandbox.client import Sandbox
from tacevo.sandbox.processes import descendants
from tacevo.storage.canonical import content_hash
from tacevo.storage.ledger import Ledger
from tacevo.storage.store import Store
from tacevo.training.evaluation import Evaluator, Setting
from tacevo.training.losses import mean_squared_error

pytestmark = pytest.mark.timeout(120)

DATA = examples()
EXAMPLES = labelled(DATA)


class Trainer:
    """Trains sources over one sandbox and keeps nothing."""

    def __init__(self, sandbox: Sandbox, root: Path) -> None:
        self._sandbox, self._root = sandbox, root

    def train(self, source: str, seconds: float = 20) -> Training | Rejection:
        """Train a source under a limit of time."""
        recipe = replace(RECIPE, limits=Limits(seconds=seconds, memory_mib=400))
        store = Store(self._root, "evaluations", Mode.live)
        setting = Setting(
            contract=CONTRACT, fingerprint=EXAMPLES.fingerprint, recipe=recipe, numerics=Numerics.portable
        )
        return Evaluator(run=self._sandbox.run, store=store, setting=setting, examples=EXAMPLES, rules=0).evaluate(
            source, 0
        )


@pytest.fixture(scope="module")
def trainer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trainer]:
    """Return one sandbox to all candidates."""
    folder = tmp_path_factory.mktemp("containment")
    np.save(folder / "images.npy", DATA.images)
    with open_sandbox(folder / "images.npy") as sandbox:
        yield Trainer(sandbox, folder)


@pytest.fixture(scope="module")
def alone(trainer: Trainer) -> Training:
    """Train the decent candidate first."""
    outcome = trainer.train(SOURCE)
    assert isinstance(outcome, Training)
    return outcome


@pytest.fixture(autouse=True)
def _no_trace(trainer: Trainer, alone: Training) -> Iterator[None]:
    """See that a candidate left neither a process nor a change behind."""
    before = set(descendants(os.getpid()))
    yield
    assert eventually(lambda: before.issuperset(descendants(os.getpid())))
    assert trainer.train(SOURCE) == alone


def rejection(outcome: Training | Rejection) -> Rejection:
    """Insist on a rejection by the training."""
    assert isinstance(outcome, Rejection), outcome
    assert outcome.stage is Stage.train
    return outcome


QUICK = ["import", "constructor", "forward", "backward hook", "finaliser"]


@pytest.mark.few(2)
@pytest.mark.parametrize(
    "place", [pytest.param(place, marks=[] if place in QUICK else pytest.mark.slow) for place in sources.ENDLESS]
)
def test_candidate_that_hangs_anywhere_is_out_of_time_and_gone(trainer: Trainer, place: str) -> None:
    """In Python, in native code or deaf to signals, it is killed and reaped before the search hears of the limit."""
    with watching_candidates() as seen:
        outcome = trainer.train(sources.ENDLESS[place], seconds=1)
        left = living(seen)
    assert rejection(outcome).reason is Reason.out_of_time
    assert seen
    assert left == []


@pytest.mark.parametrize("source", sources.ENDLESS_AFTERWARDS.values(), ids=sources.ENDLESS_AFTERWARDS.keys())
def test_candidate_that_would_hang_at_its_end_is_evaluated_and_gone(trainer: Trainer, source: str) -> None:
    """What it left for its end holds up neither its answer nor its own end."""
    with watching_candidates() as seen:
        outcome = trainer.train(source, seconds=2)
        left = living(seen)
    assert isinstance(outcome, Training)
    assert seen
    assert left == []


@pytest.mark.few(2)
@pytest.mark.parametrize("source", sources.GREEDY.values(), ids=sources.GREEDY.keys())
def test_candidate_over_its_memory_is_out_of_memory(trainer: Trainer, source: str) -> None:
    """Tensors, weights, Python's objects and activations count alike."""
    assert rejection(trainer.train(source)).reason is Reason.out_of_memory


@pytest.mark.few(9)
@pytest.mark.parametrize("source", sources.NO_PREDICTIONS.values(), ids=sources.NO_PREDICTIONS.keys())
def test_what_is_no_prediction_has_no_fitness(trainer: Trainer, source: str) -> None:
    """Shapes, types, numbers and amounts are checked outside, whatever was done to the checks inside."""
    outcome = rejection(trainer.train(source))
    assert outcome.reason in {Reason.bad_output, Reason.not_finite, Reason.backward_failed, Reason.crashed}


@pytest.mark.parametrize("source", sources.PATCHES.values(), ids=sources.PATCHES.keys())
def test_patched_code_makes_nobody_better(trainer: Trainer, alone: Training, source: str) -> None:
    """The loss is computed outside from what was predicted: none of these gains by what it changes inside."""
    outcome = trainer.train(source)
    assert isinstance(outcome, Rejection) or outcome.validation_losses[-1] >= alone.validation_losses[-1]


def test_patched_seeds_are_refused_by_the_policy(trainer: Trainer) -> None:
    """A known limit of the trainer, in which they are another draw; what stands against it is the check of the text."""
    assert isinstance(trainer.train(sources.SEEDS), Training)
    refused = rejection_of(sources.SEEDS, CONTRACT)
    assert refused is not None
    assert refused.stage is Stage.policy


def steps_of(outcome: Training) -> int:
    """Read how many steps were taken, which `sources.MORE_STEPS` sends in place of a digest."""
    return int(outcome.weights_sha256, 16)


def test_more_steps_of_the_trainer_are_noticed(trainer: Trainer) -> None:
    """The optimiser's own count comes with each epoch, and is not what was asked for."""
    assert rejection(trainer.train(sources.MORE_STEPS)).reason is Reason.bad_output


@pytest.mark.slow
def test_more_steps_beside_the_trainer_pay_and_are_refused_by_the_policy(trainer: Trainer, alone: Training) -> None:
    """A known limit: who resets that count is not seen; what stands against it is the check of the text."""
    hidden = sources.MORE_STEPS.replace("return loss", sources.COUNT_RESET)
    assert hidden != sources.MORE_STEPS
    outcome = trainer.train(hidden)
    assert isinstance(outcome, Training)
    batches = len(EXAMPLES.train) // RECIPE.batch_size
    assert steps_of(outcome) == 20 * batches * RECIPE.epochs
    assert outcome.validation_losses[-1] < alone.validation_losses[-1]
    assert trainer.train(hidden) == outcome  # as `replay --retrain` shows it to whoever reads the source
    refused = rejection_of(sources.MORE_STEPS, CONTRACT)
    assert refused is not None
    assert (refused.stage, refused.reason) == (Stage.policy, Reason.forbidden_import)
    assert rejection_of(SOURCE, CONTRACT) is None


def test_more_steps_than_the_time_limit_allows_give_no_fitness(trainer: Trainer) -> None:
    """Whoever trains for ever is out of time: what an answer may cost bounds what can be gained."""
    endless = sources.MORE_STEPS.replace("range(20)", "iter(int, 1)")
    assert endless != sources.MORE_STEPS
    assert rejection(trainer.train(endless, seconds=1)).reason is Reason.out_of_time


def test_forged_answer_is_worth_what_it_predicts(trainer: Trainer) -> None:
    """Who writes the answer itself gets the loss of just these predictions, and no other."""
    outcome = trainer.train(sources.FORGED_ANSWER)
    assert isinstance(outcome, Training)
    guess = np.full(EXAMPLES.validation_targets.shape, 0.5, np.float32)
    assert outcome.validation_losses[-1] == pytest.approx(
        mean_squared_error(guess, EXAMPLES.validation_targets), rel=1e-8
    )


GOOD = [SOURCE.replace("32", str(width)) for width in (24, 32, 40)]
BAD = [
    *sources.PATCHES.values(),
    sources.ENDLESS["forward"],
    sources.ENDLESS["import"],
    sources.GREEDY["tensor"],
    sources.NO_PREDICTIONS["no number"],
    sources.FORGED_ANSWER,
]


class MixedLLM:
    """Answers every other request with a hostile candidate."""

    def complete(self, requests: Sequence[Request]) -> Iterator[tuple[int, Completion]]:
        """Choose by the request, so that the answers are the same in every order."""
        for position, request in enumerate(requests):
            draw = fakes.number(content_hash(to_json(request)), 10**6)
            text = BAD[draw // 2 % len(BAD)] if draw % 2 else GOOD[draw // 2 % len(GOOD)]
            answer = Completion(text=text, model="mixed", stop_reason="end_turn", input_tokens=1, output_tokens=1)
            yield position, answer


def admit(source: str) -> Admitted:
    """Admit every source with a profile that follows from its text: neither policy nor probe protect this search."""
    admitted = fakes.inspect(f"class Net: {source}")
    assert isinstance(admitted, Admitted)
    return replace(admitted, source=source)


@pytest.mark.slow
def test_search_gives_good_candidates_the_fitness_they_have_alone(trainer: Trainer) -> None:
    """Hostile neighbours, before and at the same time, change nothing for the others."""
    expected = {source: trainer.train(source) for source in GOOD}
    recorder = fakes.Recorder()
    plan = replace(fakes.plan(generations=2), task=replace(fakes.TASK, baseline=GOOD[0]))
    with ThreadPoolExecutor(3) as executor:
        effects = replace(
            fakes.effects(executor=executor),
            llm=MixedLLM(),
            admit=lambda completion, asked: admit(completion.text),
            inspect=admit,
            measure=admit,
            evaluate=lambda source: trainer.train(source, seconds=2),
        )
        run_search(plan, effects, Ledger(), recorder)
    results = [(outcome.admitted.source, outcome.result) for outcome in recorder.outcomes if outcome.admitted]
    assert {source for source, _ in results} >= set(GOOD)
    assert {source for source, _ in results} & set(BAD)
    assert all(result == expected[source] for source, result in results if source in expected)
