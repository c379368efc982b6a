"""What finished studies and sweeps say for the plan of the next one: how its values will spread, and what they cost."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis.runs.run import Run
from analysis.statistics.planning import Spread, median_deviation, pooled
from analysis.studies.scores import Study
from analysis.sweeps.sweep import Finished, Sweep
from tacevo.errors import RunError
from tacevo.storage.plan import Measure
from tacevo.storage.run_directory import RunDirectory

#: A candidate that took less, in seconds, was recalled from a store and not trained.
RECALLED = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Pilot:
    """What one or several pilots say."""

    kind: Literal["study", "sweep"]
    task: str
    metric: Measure
    #: Of one value, of logarithms for an error: a training seed of a study, a job of a sweep.
    spread: Spread
    #: The deviation of a job's network over its training seeds; 0 of a study, and where jobs were not tested.
    within: float
    #: The part of `spread` that comes from there, since the pilot trained with so few seeds.
    tested: float
    #: Variants of a study, or arms beside the reference; at least 1.
    comparisons: int
    #: Of each full training; None where there are none.
    epochs: int | None
    #: Of all trainings of one search, the largest; 0 of a study.
    search_epochs: int
    #: Of one epoch on one worker; None where no run recorded a training's time.
    seconds: float | None
    #: Digests of its runs.
    runs: tuple[str, ...]


def is_error(metric: Measure) -> bool:
    """Return whether values of a metric are errors, whose spread is in proportion to their size."""
    return metric is not Measure.accuracy


def study_pilot(pilots: Sequence[tuple[Run, Study]]) -> Pilot:
    """Return what studies say of the next one.

    Raises:
        RunError: they are of several tasks, epochs or metrics, or have a single seed, or a value of 0.
    """
    runs, studies = [run for run, _ in pilots], [study for _, study in pilots]
    first = studies[0]
    _check_alike([(study.task, study.recipe.epochs) for study in studies])
    return Pilot(
        kind="study",
        task=first.task,
        metric=Measure(first.primary),
        spread=_study_spread(studies),
        within=0.0,
        tested=0.0,
        comparisons=max(1, *(len(study.networks) - 1 for study in studies)),
        epochs=first.recipe.epochs,
        search_epochs=0,
        seconds=_seconds(runs),
        runs=_digests(runs),
    )


def spread_of(study: Study) -> float | None:
    """Return how the seeds of a study's networks spread; None of a single seed, or where an error is 0."""
    try:
        return _study_spread([study]).deviation
    except RunError:
        return None


def sweep_pilot(pilots: Sequence[Sweep]) -> Pilot:
    """Return what sweeps say of the next one: by their test scores, or by their best fitness where a job has none.

    Raises:
        RunError: they are of several tasks or epochs, or no arm has two jobs, or a value is 0.
    """
    jobs = [one for sweep in pilots for one in sweep.finished]
    runs, scores = [one.run for one in jobs], [one.tested for one in jobs if one.tested is not None]
    is_tested = len(scores) == len(jobs)
    stated = [sweep.terms.retraining for sweep in pilots] if is_tested else [None] * len(pilots)
    _check_alike([(sweep.task, terms) for sweep, terms in zip(pilots, stated, strict=True)])
    metric = Measure(scores[0].metric) if is_tested else Measure.fitness
    arms = [
        _scaled([_value(one, is_tested) for one in sweep.finished if one.job.arm == arm], metric)
        for sweep in pilots
        for arm in dict.fromkeys(one.job.arm for one in sweep.finished)
    ]
    seeds = len(scores[0].values) if is_tested else 1
    within = pooled([_scaled(score.values, metric) for score in scores]) if seeds > 1 and is_tested else None
    deviation = 0.0 if within is None else within.deviation
    return Pilot(
        kind="sweep",
        task=pilots[0].task,
        metric=metric,
        spread=_pooled(arms, "two jobs of an arm"),
        within=deviation,
        tested=deviation * median_deviation(seeds),
        comparisons=max(1, *(len({one.job.arm for one in sweep.finished}) - 1 for sweep in pilots)),
        epochs=stated[0].epochs if stated[0] is not None else None,
        search_epochs=max(len(run.trained) * run.config.training.epochs for run in runs),
        seconds=_seconds(runs),
        runs=_digests(runs),
    )


def _study_spread(studies: Sequence[Study]) -> Spread:
    samples = [
        _scaled(study.values(network.name, study.primary), Measure(study.primary))
        for study in studies
        for network in study.networks
    ]
    return _pooled(samples, "two seeds of a network")


def _value(one: Finished, is_tested: bool) -> float:
    if is_tested and one.tested is not None:
        return one.tested.value
    return one.run.generations[-1].best or 0.0


def _scaled(values: ArrayLike, metric: Measure) -> NDArray[np.float64]:
    """Return values on the scale that they are taken to be normal on: an error's logarithm."""
    found = np.asarray(values, dtype=np.float64)
    if not is_error(metric):
        return found
    if not (found > 0).all():
        raise RunError("0", place=f"a pilot's {metric}", expected="values above 0, which have a logarithm")
    return np.log(found)


def _pooled(samples: Sequence[NDArray[np.float64]], needed: str) -> Spread:
    spread = pooled([sample for sample in samples if len(sample) > 1])
    if spread is None:
        raise RunError("none", place="the pilots", expected=f"{needed}, without which there is no spread")
    return spread


def _check_alike(terms: Sequence[Hashable]) -> None:
    if len(set(terms)) > 1:
        raise RunError(
            " and ".join(map(str, dict.fromkeys(terms))),
            place="the pilots",
            expected="one task, and full trainings of one kind",
            remedy="plan from those that are alike",
        )


def _seconds(runs: Sequence[Run]) -> float | None:
    """Return the time of one epoch: the median over the candidates that were trained, and not recalled."""
    found = [
        timing.seconds / run.config.training.epochs
        for run in runs
        for timing in RunDirectory(run.path).read_timings()
        if timing.seconds is not None and timing.id in {one.id for one in run.trained} and timing.seconds > RECALLED
    ]
    return median(found) if found else None


def _digests(runs: Sequence[Run]) -> tuple[str, ...]:
    return tuple(sorted({run.digest for run in runs}))
