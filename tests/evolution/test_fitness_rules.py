"""Promise: `training.fitness` decides what a fitness is of the losses of its training, everywhere, and nothing else."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import fakes
import numpy as np
import pytest
from smallest import PUBLISHED_SIZES, SMALLEST, UNTRACKED

from analysis.report.collection import collect
from tacevo.cli.app import main
from tacevo.evolution.fitness import Last, Lowest, MeanOf3
from tacevo.evolution.lines import CandidateLine
from tacevo.parts import Fitness
from tacevo.records import Rejection, Training
from tacevo.results.run import read_run
from tacevo.results.study_directory import studies_of
from tacevo.results.study_lines import ScoreLine
from tacevo.rounding import rounded
from tacevo.storage.store import Store
from tacevo.storage.verdicts import read_verdict

LOSSES = (0.5, 0.25, 1.0, 0.375, 0.3125)


@pytest.mark.parametrize(
    ("rule", "losses", "fitness"),
    [
        (Last(), LOSSES, 0.3125),
        (Lowest(), LOSSES, 0.25),
        (MeanOf3(), LOSSES, 0.5625),
        (MeanOf3(), (0.5, 0.25), 0.375),
        *((rule, (0.5,), 0.5) for rule in (Last(), Lowest(), MeanOf3())),
    ],
)
def test_fitness_of_a_training(rule: Fitness, losses: tuple[float, ...], fitness: float) -> None:
    """Of the last, the lowest, or the last three losses; of those that there are, where they are fewer."""
    assert rule.of(losses) == fitness


def jumping(source: str) -> Training | Rejection:
    """Train by hashing, to losses that jump from epoch to epoch."""
    result = fakes.evaluate(source)
    if isinstance(result, Rejection):
        return result
    losses = tuple((1 + fakes.number(f"{source} {epoch}", 1_000)) / 1_000 for epoch in range(5))
    return replace(result, train_losses=losses, validation_losses=losses)


#: By other code than the rules'.
BY_HAND: dict[Fitness, Callable[[Sequence[float]], float]] = {
    Last(): lambda losses: float(np.take(losses, -1)),
    Lowest(): lambda losses: sorted(losses)[0],
    MeanOf3(): lambda losses: rounded(fmean(losses[2:])),
}


@pytest.mark.parametrize("rule", BY_HAND)
def test_every_fitness_of_a_search_follows_the_rule(rule: Fitness) -> None:
    """That of candidates, of the archive, and of its best."""
    plan = replace(fakes.plan(generations=6), fitness=rule)
    _, recorder = fakes.search(plan, evaluate=jumping)
    expected: dict[str, float] = {}
    for line in recorder.lines:
        if isinstance(line, CandidateLine) and line.validation_losses is not None:
            assert line.fitness == BY_HAND[rule](line.validation_losses)
            expected[line.id] = line.fitness
    last = recorder.states[-1]
    assert {name: one.fitness for name, one in last.candidates.items()} == expected
    assert all(-elite.objective == expected[elite.name] for elite in last.networks.archive.elites.values())
    assert last.best == min(-elite.objective for elite in last.networks.archive.elites.values()) < math.inf


@pytest.mark.slow
@pytest.mark.room("noise")
@pytest.mark.parametrize(("name", "rule"), [("lowest", Lowest()), ("mean_of_3", MeanOf3())])
def test_a_run_by_another_rule(name: str, rule: Fitness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Search, noise run, study, replay and API take one fitness; trainings are shared with the paper's rule."""
    from analysis.studies.noise import SeedNoise

    monkeypatch.chdir(tmp_path)
    sizes = [
        *SMALLEST,
        UNTRACKED,
        *PUBLISHED_SIZES,
        "training.epochs=4",
        "training.learning_rate=0.1",
        "store.root=cache",
    ]
    assert main(["search", *sizes, "run.dir=other", f"training.fitness={name}"]) == 0
    assert main(["search", *sizes, "run.dir=paper", "training.fitness=last"]) == 0
    assert main(["noise", "other", "elites=1", "seeds=2"]) == 0
    assert main(["study", "run=other", "elites=1", "seeds=4", "epochs=5"]) == 0
    assert main(["replay", "other"]) == 0
    run, paper = read_run(Path("other")), read_run(Path("paper"))
    assert (run.config.training.fitness, paper.config.training.fitness) == (name, "last")
    assert run.baseline.evaluation == paper.baseline.evaluation
    for line in run.trained:
        assert line.validation_losses is not None
        assert line.fitness == rule.of(line.validation_losses)
    assert any(rule.of(line.validation_losses or ()) != (line.validation_losses or ())[-1] for line in run.trained)
    noise = next(study for study in studies_of(run.path) if study.read().terms is None)
    store = {
        one.key: read_verdict(Training, "training", one.answer, place=one.key)
        for one in Store(Path("cache"), "evaluations").entries()
    }
    for row in noise.read_finished().rows:
        assert isinstance(row, ScoreLine)
        training = store[row.evaluation]
        assert isinstance(training, Training)
        assert row.validation_loss == rule.of(training.validation_losses)
    of_study, of_noise = collect(run.path, Path("cache")).reestimates
    assert (of_study.rule, of_noise.rule) == (name, name)
    assert of_study.curves is not None
    assert SeedNoise(of_study).frame.recorded.tolist() == [run.fitness[one.id] for one in of_study.networks]
