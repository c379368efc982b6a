"""The arms of a sweep: what each run came to, what an arm came to over its seeds, how it differs from the reference.

Every arm is compared with the reference arm in every metric: the test of Mann and Whitney over all seeds of both, with
Holm's correction over the arms, metric by metric; and, since arms share their seeds, the differences between runs of
one seed. A run that is the reference's own, candidate by candidate, says nothing of its arm and enters neither.
docs/ablation_study.md says why these.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from analysis.runs.dynamics import improvement, spending, spent_on_training
from analysis.runs.run import Run
from analysis.statistics.effects import Effects, Interval, effects, median
from analysis.statistics.tests import MannWhitney, holm, mann_whitney, smallest_p
from analysis.studies.warnings import Caution, cautions
from analysis.sweeps.common_archive import CommonArchive, Filled, filled
from analysis.sweeps.metrics import LESS_IS_BETTER, SPENT, TESTS, Metric
from analysis.sweeps.sweep import REFERENCE, Finished
from tacevo.evolution.lines import CandidateLine
from tacevo.randomness import stream
from tacevo.rounding import rounded
from tacevo.storage.sweep_directory import Job

#: The level that cautions are judged at, after Holm's correction.
ALPHA = 0.05

#: Below this many seeds there is neither an interval nor a test.
FEWEST_SEEDS = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What one run came to."""

    job: str
    arm: str
    seed: int
    #: Of every metric; None where the run's files do not have it.
    values: Mapping[Metric, float | None]
    #: Best fitness by generation; None before anything was trained.
    best: tuple[float | None, ...]
    #: The common archive by generation.
    filled: tuple[Filled, ...]
    #: What was asked and what came of it, slot by slot: equal in runs that are one and the same search.
    slots: tuple[CandidateLine, ...]


class Comparability(StrEnum):
    """Whether there is anything to test between two arms; the values are what a table says."""

    comparable = "comparable"
    #: No runs differ; or those that do have one value a seed in both arms, or one value in all.
    identical = "identical"
    #: One of both arms has fewer than two runs that differ from the other's of the same seed.
    too_few_differ = "too few runs differ"
    #: One of both arms has values of fewer than two seeds.
    too_few_seeds = "too few seeds"


@dataclass(frozen=True, slots=True, kw_only=True)
class Paired:
    """An arm against the reference, seed by seed, where their runs differ."""

    #: Of the differences arm - reference; None below two shared seeds.
    difference: Interval | None
    #: Shared seeds on which the arm was better, equal and worse.
    better: int
    equal: int
    worse: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Contrast:
    """An arm against the reference in one metric; runs of both that are one and the same are not compared."""

    comparability: Comparability
    #: Runs of the arm that are not the reference's of the same seed, whether their value is known or not.
    differing: int
    #: Values of the runs that differ, known ones and those of jobs that failed: the arm's, and the reference's.
    sizes: tuple[int, int]
    paired: Paired
    #: These are None unless the arms are `comparable`.
    test: MannWhitney | None
    #: After Holm's correction over all arms but those of too few seeds.
    p_holm: float | None
    effects: Effects | None
    cautions: tuple[Caution, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """An arm in one metric."""

    #: Values by seed, those that are known.
    values: Mapping[int, float]
    #: None where no value is known.
    median: float | None
    #: Of the median; None below two seeds.
    interval: Interval | None
    #: None for the reference itself, and without a reference.
    contrast: Contrast | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Arm:
    """One arm of a sweep."""

    name: str
    #: Of its outcomes; none where all its jobs failed.
    seeds: tuple[int, ...]
    metrics: Mapping[Metric, Summary]


@dataclass(frozen=True, slots=True, kw_only=True)
class Ablation:
    """A sweep, compared."""

    #: The arm that others are compared with; None where `wanted` has no finished run.
    reference: str | None
    #: The arm that they are to be compared with.
    wanted: str
    #: What they are compared by first; None where the sweep does not state it.
    primary: Metric | None
    #: Those that are shown: a test score only where a run has one.
    metrics: tuple[Metric, ...]
    #: The reference first.
    arms: tuple[Arm, ...]
    outcomes: tuple[Outcome, ...]


def outcome(one: Finished, common: CommonArchive) -> Outcome:
    """Measure a finished run."""
    places = filled(one.run, common)
    return Outcome(
        job=one.job.name,
        arm=one.job.arm,
        seed=one.job.seed,
        values={**_values(one.run, places[-1]), **_test_scores(one)},
        best=tuple(line.best for line in one.run.generations),
        filled=places,
        slots=slots_of(one.run),
    )


def compare_arms(
    outcomes: Sequence[Outcome],
    *,
    wanted: str = REFERENCE,
    primary: Metric | None = None,
    failed: Sequence[Job] = (),
    seed: int = 0,
) -> Ablation:
    """Summarise every arm, and compare it with the reference.

    A run that its FLOPs ended before others stays where it ended.

    Args:
        outcomes: of the runs.
        wanted: the arm to compare with.
        primary: the metric that the sweep states.
        failed: jobs without an outcome, or without a test score, because they failed. Compared is what an arm comes to
            with them: in tests, effect sizes and differences each counts as worse than any other job. Otherwise an arm
            would be the better for every job that it loses.
        seed: of the bootstrap. Each arm and metric has a stream of its own, so equal values have equal intervals,
            whatever other arms there are.
    """
    longest = max(len(one.best) for one in outcomes)
    outcomes = [_lasting(one, longest) for one in outcomes]
    begun = dict.fromkeys([*(one.arm for one in outcomes), *(job.arm for job in failed)])
    names = sorted(begun, key=lambda name: name != wanted)
    reference = wanted if any(one.arm == wanted for one in outcomes) else None
    lost = {metric: _lost(metric, outcomes, failed) for metric in Metric}
    summaries = {
        metric: _summaries(metric, names, outcomes, reference=reference, lost=lost[metric], seed=seed)
        for metric in Metric
    }
    tests = frozenset(TESTS.values())
    return Ablation(
        reference=reference,
        wanted=wanted,
        primary=primary,
        metrics=tuple(
            metric
            for metric in Metric
            if metric not in tests or any(found.values for found in summaries[metric].values())
        ),
        arms=tuple(
            Arm(
                name=name,
                seeds=tuple(one.seed for one in outcomes if one.arm == name),
                metrics={metric: summaries[metric][name] for metric in Metric},
            )
            for name in names
        ),
        outcomes=tuple(outcomes),
    )


def _lasting(one: Outcome, generations: int) -> Outcome:
    """Return a run as if it had found nothing more in the generations that it did not have."""
    missing = generations - len(one.best)
    return replace(one, best=one.best + one.best[-1:] * missing, filled=one.filled + one.filled[-1:] * missing)


def _values(run: Run, end: Filled) -> dict[Metric, float | None]:
    found, spent = improvement(run), spending(run, run.candidates)
    return {
        Metric.best_fitness: None if found is None else found.last,
        Metric.improvement: None if found is None else rounded(found.over_first),
        Metric.improvement_over_baseline: None if found is None else rounded(found.over_baseline),
        Metric.qd_score: end.qd_score,
        Metric.coverage: end.coverage,
        Metric.trainable: None if found is None or found.trainable is None else rounded(found.trainable),
        Metric.candidates: len(run.candidates),
        Metric.evaluations: run.seeds * len({one.evaluation for one in (*run.candidates, *run.reevaluations)} - {None}),
        Metric.training_flops: rounded(spent_on_training(run) / 1e12),
        Metric.tokens: None if spent is None else spent.tokens,
        Metric.cost: None if spent is None or spent.unpriced else rounded(spent.usd),
    }


def _test_scores(one: Finished) -> dict[Metric, float | None]:
    found = {} if one.tested is None else {TESTS[one.tested.metric]: one.tested.value}
    return {metric: found.get(metric) for metric in TESTS.values()}


def slots_of(run: Run) -> tuple[CandidateLine, ...]:
    """Return what two runs are compared by, candidate by candidate."""
    return tuple(map(_slot, run.candidates))


def _slot(candidate: CandidateLine) -> CandidateLine:
    """Leave out what changes no network: texts of requests and answers, and what the prompt archive recorded."""
    return replace(
        candidate,
        temperature=candidate.sent_temperature,
        request=None,
        answer=None,
        repairs=tuple(replace(sent, answer="") for sent in candidate.repairs),
        curiosity=None,
        prompt_niche=None,
        prompt_status=None,
    )


def _lost(metric: Metric, outcomes: Sequence[Outcome], failed: Sequence[Job]) -> list[tuple[str, int]]:
    """Return arm and seed of the jobs that failed at what a metric measures; one whose search ended failed its test."""
    if metric in SPENT:
        return []
    ended = {(one.arm, one.seed) for one in outcomes}
    places = [(job.arm, job.seed) for job in failed]
    return places if metric in TESTS.values() else [place for place in places if place not in ended]


def _with_lost(
    metric: Metric, samples: Mapping[str, Mapping[int, float]], lost: Sequence[tuple[str, int]]
) -> dict[str, Mapping[int, float]]:
    """Add the jobs that failed to the samples, next to the worst value that any job has: last in rank, and finite."""
    every = [value for sample in samples.values() for value in sample.values()]
    if not every:
        return dict(samples)
    is_less = metric in LESS_IS_BETTER
    worst = math.nextafter(max(every), math.inf) if is_less else math.nextafter(min(every), -math.inf)
    found: dict[str, Mapping[int, float]] = {}
    for name, sample in samples.items():
        whole = {**sample, **{seed: worst for arm, seed in lost if arm == name}}
        found[name] = {seed: whole[seed] for seed in sorted(whole)}
    return found


def _summaries(
    metric: Metric,
    names: Sequence[str],
    outcomes: Sequence[Outcome],
    *,
    reference: str | None,
    lost: Sequence[tuple[str, int]],
    seed: int,
) -> dict[str, Summary]:
    """Summarise all arms in one metric; the jobs that were lost count in the contrasts only."""
    samples = {name: _known(metric, name, outcomes) for name in names}
    contrasts: dict[str, Contrast] = {}
    if reference is not None:
        same = {name: _same_runs(name, outcomes, reference) for name in names if name != reference}
        runs = Counter(arm for arm, _ in {*((one.arm, one.seed) for one in outcomes), *lost})
        whole = _with_lost(metric, samples, lost)
        contrasts = _contrasts(metric, whole, reference=reference, same=same, runs=runs, seed=seed)
    return {
        name: Summary(
            values=sample,
            median=rounded(float(np.median(list(sample.values())))) if sample else None,
            interval=_interval(list(sample.values())),
            contrast=contrasts.get(name),
        )
        for name, sample in samples.items()
    }


def _known(metric: Metric, name: str, outcomes: Sequence[Outcome]) -> dict[int, float]:
    """Return an arm's known values by seed, in the order of the seeds."""
    values = {one.seed: one.values[metric] for one in outcomes if one.arm == name}
    return {seed: value for seed in sorted(values) if (value := values[seed]) is not None}


def _same_runs(name: str, outcomes: Sequence[Outcome], reference: str) -> frozenset[int]:
    """Find the seeds of which an arm's run is the reference's, candidate by candidate."""
    theirs = {one.seed: one.slots for one in outcomes if one.arm == reference}
    return frozenset(one.seed for one in outcomes if one.arm == name and one.slots == theirs.get(one.seed))


def _contrasts(
    metric: Metric,
    samples: Mapping[str, Mapping[int, float]],
    *,
    reference: str,
    same: Mapping[str, Set[int]],
    runs: Mapping[str, int],
    seed: int,
) -> dict[str, Contrast]:
    """Compare the samples of all other arms with the reference's, and correct the family's p-values.

    An arm that has seeds enough and is not tested counts in the family with p = 1, so that the family's size does not
    depend on what the runs found.

    Args:
        metric: what the samples are of.
        samples: by arm and seed.
        reference: the arm to compare with.
        same: by every other arm, the seeds of which its run is the reference's.
        runs: by arm, how many it has; some may have no known value.
        seed: of the bootstrap.
    """
    ours = {name: _without(samples[name], seeds) for name, seeds in same.items()}
    theirs = {name: _without(samples[reference], seeds) for name, seeds in same.items()}
    enough = {name: min(len(samples[name]), len(samples[reference])) >= FEWEST_SEEDS for name in same}
    kinds = {
        name: _comparability(ours[name], theirs[name]) if enough[name] else Comparability.too_few_seeds for name in same
    }
    family = [name for name in same if enough[name]]
    pairs = {name: (list(ours[name].values()), list(theirs[name].values())) for name in family}
    tests = {name: mann_whitney(*pairs[name]) for name in family if kinds[name] is Comparability.comparable}
    p_holm = _corrected({name: tests[name].p if name in tests else 1.0 for name in family})
    least = _corrected({name: smallest_p(*map(len, pairs[name])) if name in tests else 1.0 for name in family})
    return {
        name: Contrast(
            comparability=kind,
            differing=runs[name] - len(same[name]),
            sizes=(len(ours[name]), len(theirs[name])),
            paired=_paired(metric, ours[name], theirs[name]),
            test=tests.get(name),
            p_holm=p_holm[name] if name in tests else None,
            effects=effects(*pairs[name], rng=stream(seed, "effects", name, metric.name)) if name in tests else None,
            cautions=cautions(*pairs[name], least_p=least[name], alpha=ALPHA) if name in tests else (),
        )
        for name, kind in kinds.items()
    }


def _corrected(p_values: Mapping[str, float]) -> dict[str, float]:
    """Correct p-values by arm after Holm; the family may be empty."""
    return dict(zip(p_values, holm(list(p_values.values())), strict=True)) if p_values else {}


def _without(sample: Mapping[int, float], seeds: Set[int]) -> Mapping[int, float]:
    return {seed: value for seed, value in sample.items() if seed not in seeds}


def _comparability(sample: Mapping[int, float], reference: Mapping[int, float]) -> Comparability:
    """Return whether a sample can be tested against the reference's, by seed both, of the runs that differ."""
    if sample == reference or len({*sample.values(), *reference.values()}) == 1:
        return Comparability.identical
    few = min(len(sample), len(reference)) < FEWEST_SEEDS
    return Comparability.too_few_differ if few else Comparability.comparable


def _paired(metric: Metric, sample: Mapping[int, float], reference: Mapping[int, float]) -> Paired:
    differences = [sample[seed] - reference[seed] for seed in sorted(sample.keys() & reference.keys())]
    lower, higher = sum(value < 0 for value in differences), sum(value > 0 for value in differences)
    better, worse = (lower, higher) if metric in LESS_IS_BETTER else (higher, lower)
    return Paired(
        difference=_interval(differences),
        better=better,
        equal=len(differences) - better - worse,
        worse=worse,
    )


def _interval(values: Sequence[float]) -> Interval | None:
    return median(values) if len(values) >= FEWEST_SEEDS else None
