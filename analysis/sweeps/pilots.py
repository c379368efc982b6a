"""Finished studies and sweeps as pilots of the next one: how its values will spread, and what they will cost."""

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis.statistics.planning import Spread, median_deviation, pooled
from analysis.sweeps.ablation import slots_of
from tacevo.choices import ChosenBy, Primary
from tacevo.config.identity import twins_of
from tacevo.errors import RunError
from tacevo.evolution.lines import CandidateLine
from tacevo.results.run import RecordedRun
from tacevo.results.study import RecordedStudy
from tacevo.results.sweep import REFERENCE, FinishedJob, RecordedSweep
from tacevo.storage.plan_file import Measure
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.sweep_directory import Retraining
from tacevo.text import as_overrides, counted, listed

#: A candidate that took less, in seconds, was recalled from a store and not trained.
RECALLED = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Pilot:
    """The spread and the costs that one or several pilots show."""

    kind: Literal["study", "sweep"]
    task: str
    metric: Measure
    #: The spread of one value, of its logarithm for an error: a training seed of a study, a job of a sweep.
    spread: Spread
    #: The deviation of a job's networks over their training seeds; 0 of a study, and where jobs were not tested.
    within: float
    #: The part of `spread` that comes from there, since the pilot trained with so few seeds.
    tested: float
    #: Networks of a job that are tested.
    elites: int = 1
    #: Elites of a job that are trained once to choose the tested one; 0 where none is chosen so.
    validated: int = 0
    #: Variants of a study, or arms beside the reference; at least 1.
    comparisons: int
    #: The epochs of each full training; None where there is none.
    epochs: int | None
    #: The epochs of all trainings of one search, of the largest one; 0 for a study.
    search_epochs: int
    #: The seconds of one epoch on one worker; None where no run recorded a training's time.
    seconds: float | None
    #: Digests of its runs.
    runs: tuple[str, ...]

    def noise(self, seeds: int) -> float:
        """Return the deviation of a job's value that comes from so many training seeds of each of its networks."""
        return _noise(self.metric, self.within, seeds, self.elites)

    @property
    def is_all_noise(self) -> bool:
        """True where the noise of its trainings alone would spread its jobs as widely as they are spread."""
        return self.tested >= self.spread.deviation

    @property
    def between(self) -> float:
        """The upper limit of the deviation between searches, > 0 if the spread is.

        It is the spread's, less what the noise of the trainings explains of it. That is at most all that was seen: a
        small pilot whose jobs happen to lie close would otherwise leave nothing, and a plan that takes all searches for
        equal. By simulation the true deviation is below it in 79 to 99 % of pilots, as a limit of 80 % should be.
        """
        return math.sqrt(self.spread.upper**2 - min(self.tested, self.spread.deviation) ** 2)


def _noise(metric: Measure, within: float, seeds: int, elites: int) -> float:
    """Return the deviation of a mean over elites of a mean, or of a median of scores, over training seeds."""
    of_one = seeds**-0.5 if metric is Measure.loss else median_deviation(seeds)
    return within * of_one / math.sqrt(elites)


def is_error(metric: Measure) -> bool:
    """Return whether values of a metric are errors, whose spread is in proportion to their size."""
    return metric is not Measure.accuracy


def study_pilot(pilots: Sequence[tuple[RecordedRun, RecordedStudy]]) -> Pilot:
    """Return what studies say of the next one; a training that several of them share counts once.

    Raises:
        RunError: they are of several tasks, epochs or metrics, or have a single seed, or a value of 0.
    """
    runs, studies = [run for run, _ in pilots], [study for _, study in pilots]
    first = studies[0]
    _check_alike(
        [
            f"{study.task}, {counted(study.recipe.epochs, 'epoch')}, numerics {study.numerics} on {study.device}"
            for study in studies
        ]
    )
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
        runs=tuple(sorted({run.digest for run in runs})),
    )


def sweep_pilot(pilots: Sequence[RecordedSweep]) -> Pilot:
    """Return what sweeps say of the next one: by their test scores, or by their best fitness where a job has none.

    By their test losses, if they tested several networks of a job, or stated these as what arms are compared by first.

    A run that is another arm's of its seed, candidate by candidate, says nothing new of how jobs spread, and a
    training that several jobs share says it once of how training seeds do.

    Raises:
        RunError: they are of several tasks or epochs, or no arm has two jobs, or a value is 0.
    """
    tested = [
        replace(each, finished=tuple(one for one in each.finished if one.job.arm not in each.not_tested))
        for each in pilots
    ]
    is_tested = all(each.finished and all(one.tested for one in each.finished) for each in tested)
    pilots = tested if is_tested else pilots
    jobs = [one for sweep in pilots for one in sweep.finished]
    runs, scores = [one.run for one in jobs], [one.tested for one in jobs if one.tested is not None]
    stated = [sweep.terms.retraining for sweep in pilots] if is_tested else [None] * len(pilots)
    _check_alike([f"{sweep.task}, {_tested(terms)}" for sweep, terms in zip(pilots, stated, strict=True)])
    elites = stated[0].tested if stated[0] is not None else 1
    is_by_loss = elites > 1 or any(sweep.terms.primary is Primary.test_loss for sweep in pilots)
    metric = Measure.fitness
    if is_tested:
        metric = Measure.loss if is_by_loss else Measure(scores[0].metric)
    arms: dict[tuple[Path, str], list[float]] = {}
    for sweep, one in _distinct_runs(pilots):
        value = one.run.generations[-1].best or 0.0
        if is_tested and one.tested:
            value = one.tested.loss if is_by_loss else one.tested.value
        arms.setdefault((sweep.path, one.job.arm), []).append(value)
    seeds = len(scores[0].values[0]) if is_tested else 1
    # The seeds of a job's study follow from the job's, so jobs that found one network, say the baseline, may have its
    # very trainings.
    samples = {
        (one.job.seed, values)
        for one in jobs
        if one.tested is not None
        for values in (one.tested.losses if is_by_loss else one.tested.values)
    }
    within = pooled([_scaled(values, metric) for _, values in sorted(samples)]) if seeds > 1 and is_tested else None
    deviation = 0.0 if within is None else within.deviation
    return Pilot(
        kind="sweep",
        task=pilots[0].task,
        metric=metric,
        spread=_pooled([_scaled(values, metric) for values in arms.values()], "two jobs of an arm"),
        within=deviation,
        tested=_noise(metric, deviation, seeds, elites),
        elites=elites,
        validated=stated[0].elites if stated[0] is not None and stated[0].choose is ChosenBy.validated else 0,
        comparisons=max(1, *(len(_tested_arms(sweep)) for sweep in pilots)),
        epochs=stated[0].epochs if stated[0] is not None else None,
        search_epochs=max(map(_epochs, runs)),
        seconds=_seconds(runs),
        runs=tuple(sorted({run.digest for run in runs})),
    )


def _tested_arms(sweep: RecordedSweep) -> set[str]:
    """Return the arms that are tested against the reference."""
    reference = sweep.terms.reference or REFERENCE
    arms = {one.job.arm for one in sweep.finished}
    return arms - {*twins_of(reference, sweep.twins)} - {reference if reference in arms else min(arms)}


def _study_spread(studies: Sequence[RecordedStudy]) -> Spread:
    samples: dict[Hashable, dict[str, float]] = {}
    for study in studies:
        sources = {network.name: network.source for network in study.networks}
        for score in study.scores:
            # By the key of the training, which studies of one run with other terms or more seeds share.
            own = samples.setdefault((study.run, study.fingerprint, sources[score.network]), {})
            own[score.evaluation] = score.metrics[study.primary]
    metric = Measure(studies[0].primary)
    return _pooled([_scaled(list(own.values()), metric) for own in samples.values()], "two seeds of a network")


def _distinct_runs(pilots: Sequence[RecordedSweep]) -> list[tuple[RecordedSweep, FinishedJob]]:
    """Return the jobs, each with its sweep, whose runs no earlier job of their seed has, candidate by candidate."""
    distinct: list[tuple[RecordedSweep, FinishedJob]] = []
    known: dict[int, list[tuple[CandidateLine, ...]]] = {}
    for sweep in pilots:
        for one in sweep.finished:
            slots, others = slots_of(one.run), known.setdefault(one.job.seed, [])
            if slots not in others:
                others.append(slots)
                distinct.append((sweep, one))
    return distinct


def _epochs(run: RecordedRun) -> int:
    """Return the epochs of all trainings of a search, further ones of elites and failed ones included."""
    trainings = {line.evaluation for line in run.candidates} - {None}
    return len(trainings) * run.config.training.epochs


def _scaled(values: ArrayLike, metric: Measure) -> NDArray[np.float64]:
    """Return values on the scale that they are taken to be normal on: an error's logarithm."""
    scaled = np.asarray(values, dtype=np.float64)
    if not is_error(metric):
        return scaled
    if not (scaled > 0).all():
        got = f"{scaled.min():g}"
        raise RunError(got, place=f"a pilot's {metric}", expected="values above 0, which have a logarithm")
    return np.log(scaled)


def _pooled(samples: Sequence[NDArray[np.float64]], needed: str) -> Spread:
    spread = pooled([sample for sample in samples if len(sample) > 1])
    if spread is None:
        got = f"samples of {listed(str(len(sample)) for sample in samples)} values"
        raise RunError(got, place="the pilots", expected=f"{needed}, to estimate a spread from")
    return spread


def _tested(stated: Retraining | None) -> str:
    if stated is None:
        return "not tested"
    seeds, epochs = counted(stated.seeds, "training seed"), counted(stated.epochs, "epoch")
    words = counted(stated.elites, "elite"), seeds, epochs, f"elites chosen by {stated.choose}"
    return ", ".join([*words, *as_overrides(stated.other_device)])


def _check_alike(terms: Sequence[str]) -> None:
    if len(set(terms)) > 1:
        raise RunError(
            "; ".join(dict.fromkeys(terms)),
            place="the pilots",
            expected="one task, and full trainings of one kind",
            remedy="plan from those that are alike",
        )


def _seconds(runs: Sequence[RecordedRun]) -> float | None:
    """Return the time of one epoch of one training: the median over the candidates that were not recalled.

    A candidate's time is that of its gate and of its trainings with all seeds.
    """
    seconds = [
        timing.seconds / run.config.training.epochs
        for run in runs
        for timing in RunDirectory(run.path).read_timings()
        if timing.seconds is not None and timing.id in {one.id for one in run.trained} and timing.seconds > RECALLED
    ]
    return median(seconds) if seconds else None
