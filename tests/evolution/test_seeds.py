"""Promise: with several training seeds the fitness is the median of their losses, and the ledger names each of them."""

from dataclasses import replace
from pathlib import Path

import fakes

from tacevo.evolution.lines import CandidateLine
from tacevo.evolution.state import Plan
from tacevo.records import Rejection, Stage, Training, written
from tacevo.storage.canonical import content_hash


def three() -> Plan:
    """Return a plan with three seeds a candidate."""
    return replace(fakes.plan(), seeds=3)


def search(plan: Plan, path: Path | None = None, **changes: object) -> tuple[str, list[CandidateLine]]:
    """Search; return the digest, and the candidates' lines."""
    digest, recorder = fakes.search(plan, path, **changes)
    return digest, [line for line in recorder.lines if isinstance(line, CandidateLine)]


def test_fitness_is_the_median_of_the_losses() -> None:
    """The line has what the training of the median gave, and every training with its key, losses and digests."""
    trained = [line for line in search(three())[1] if line.fitness is not None]
    assert len(trained) > 5
    for line in trained:
        losses = [one.validation_losses[-1] for one in line.seeds]
        assert [one.seed for one in line.seeds] == [0, 1, 2]
        assert line.fitness == sorted(losses)[1] == losses[line.seed]
        assert (line.evaluation, line.weights) == (line.seeds[line.seed].evaluation, f"{line.seed:064}")
        assert [one.weights for one in line.seeds] == [f"{seed:064}" for seed in range(3)]
        assert len({one.evaluation for one in line.seeds}) == 3
    assert {line.seed for line in trained} == {0, 1, 2}


def test_network_that_fails_with_one_seed_is_rejected() -> None:
    """The verdict is that of the first seed that failed; a median over the others would reward it for failing."""
    lines = [line for line in search(three())[1] if line.stage is Stage.train]
    assert {line.seed for line in lines} == {0, 1}
    assert all((line.seeds, line.fitness, line.niche) == ((), None, None) for line in lines)
    one_seed = {line.id: line for line in search(replace(three(), seeds=1))[1]}
    luckier = [line for line in lines if line.seed == 1 and one_seed[line.id].source == line.source]
    assert luckier
    assert all(one_seed[line.id].fitness is not None for line in luckier)


def test_every_training_names_what_has_no_deterministic_form() -> None:
    """Also where it is not that of the median; a training that has nothing to name keeps its bytes."""

    def flagged(source: str, seed: int) -> Training | Rejection:
        result = fakes.noisy(source, seed)
        return (
            replace(result, not_deterministic=("scatter_add",))
            if seed == 2 and isinstance(result, Training)
            else result
        )

    lines = [line for line in search(three(), evaluate=flagged)[1] if line.fitness is not None]
    assert any(line.seed != 2 for line in lines)
    for line in lines:
        assert [one.not_deterministic for one in line.by_seed()] == [(), (), ("scatter_add",)]
        assert ["not_deterministic" in written(one) for one in line.seeds] == [False, False, True]


def test_each_source_is_trained_once_with_each_seed() -> None:
    """Candidates of one source share their trainings within a generation."""
    calls: list[tuple[str, int]] = []

    def counted(source: str, seed: int) -> Training | Rejection:
        calls.append((source, seed))
        return fakes.noisy(source, seed)

    search(replace(three(), generations=0, initial=60), evaluate=counted)
    assert len(calls) == len(set(calls))
    assert {seed for _, seed in calls} == {0, 1, 2}


def test_every_training_of_a_line_can_be_compared_with_a_retraining() -> None:
    """A line for each seed, with what is that training's."""
    line = next(line for line in search(three())[1] if line.fitness is not None)
    parts = line.by_seed()
    assert [(one.seed, one.weights) for one in parts] == [(seed, f"{seed:064}") for seed in range(3)]
    assert [one.evaluation for one in parts] == [
        content_hash([fakes.TASK.baseline, seed] if seed else fakes.TASK.baseline) for seed in range(3)
    ]
    assert line.by_seed()[line.seed].validation_losses == line.validation_losses
