"""The arms of a sweep: what each run came to, what an arm came to over its seeds, how it differs from the reference.

Every arm is compared with the reference arm in every metric: the test of Mann and Whitney over all seeds of both, with
Holm's correction over the arms, metric by metric; and, since arms share their seeds, the differences between runs of
one seed. A run that is the reference's own, candidate by candidate, says nothing of its arm and enters neither.
docs/ablation_study.md says why these, and docs/analysis.md has the columns of the frames.
"""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.runs.dynamics import improvement, spending, spent_on_training
from analysis.statistics.effects import EFFECTS, effects, median
from analysis.statistics.tests import holm, mann_whitney, smallest_p
from analysis.studies.warnings import cautions
from analysis.sweeps.arm_metrics import COUNTS, LESS_IS_BETTER, SPENT, TESTED, TESTS, Metric
from analysis.sweeps.common_archive import CommonArchive, filled
from tacevo.config.identity import twins_of
from tacevo.evolution.lines import CandidateLine
from tacevo.randomness import stream
from tacevo.results.run import RecordedRun
from tacevo.results.sweep import ALPHA, REFERENCE, FinishedJob
from tacevo.rounding import rounded
from tacevo.storage.sweep_directory import Job

#: Below this many seeds there is neither an interval nor a test.
FEWEST_SEEDS = 2

#: The metrics that are known of a run after each generation.
CURVES = (Metric.best_fitness, Metric.qd_score, Metric.coverage)

QUARTILES = (0.25, 0.5, 0.75)

#: The columns of a frame of jobs, whose index is `job`, and the type of each. Jobs of one number `search` are one and
#: the same search, candidate by candidate; metrics are fractions, losses and counts, missing where no file has them.
JOBS = {"arm": "str", "seed": "int64", "search": "int64"} | {
    metric.name: "Int64" if metric in COUNTS else "float64" for metric in Metric
}

#: The columns of a frame of arms in one metric, whose index is `arm`, and the type of each:
#: finished runs, and those `n` of known value; their median with its interval, from two seeds on. Of all arms but the
#: reference: how comparable they are; how many runs differ from the reference's of the seed, whether their value is
#: known or not; how many values of the arm and of the reference are compared, jobs that failed among them; the median
#: difference by seed, and on how many seeds the arm is better, equal and worse. Of those that are comparable: the test,
#: its p before and after Holm's correction over all arms but those of too few seeds, the effects, the cautions.
ARMS = (
    dict.fromkeys(("runs", "n"), "int64")
    | dict.fromkeys(("median", "median_low", "median_high"), "float64")
    | {"comparability": "str"}
    | dict.fromkeys(("differing", "n_arm", "n_reference"), "Int64")
    | dict.fromkeys(("by_seed", "by_seed_low", "by_seed_high"), "float64")
    | dict.fromkeys(("better", "equal", "worse"), "Int64")
    | {"u": "float64", "p": "float64", "p_holm": "float64", "method": "str"}
    | dict.fromkeys(EFFECTS, "float64")
    | {"cautions": "object"}
)


class Comparability(StrEnum):
    """The reason for which two arms are tested against each other, or not; the values are the words of a table."""

    comparable = "comparable"
    #: Their settings differ in nothing that a search draws by.
    by_construction = "identical by construction"
    #: No runs differ.
    identical = "identical"
    #: Runs differ, and have one value a seed in both arms, or one value in all.
    equal_values = "equal values"
    #: The sweep states that the arm is not tested.
    not_tested = "not tested"
    #: One of both arms has fewer than two runs that differ from the other's of the same seed.
    too_few_differ = "too few runs differ"
    #: One of both arms has values of fewer than two seeds.
    too_few_seeds = "too few seeds"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ablation:
    """A sweep, compared."""

    #: The arm that others are compared with; None where `requested_reference` has no finished run.
    reference: str | None
    #: The arm that they are to be compared with.
    requested_reference: str
    #: The metric that they are compared by first; None where the sweep does not state it.
    primary: Metric | None
    #: A row for each finished run (`JOBS`).
    jobs: pd.DataFrame
    #: Pairs of arms that are one search by construction.
    twins: Sequence[tuple[str, str]]
    #: A frame for each metric that is shown: a row for each arm, the reference first (`ARMS`).
    arms: Mapping[Metric, pd.DataFrame]

    @property
    def names(self) -> list[str]:
        """The arms, the reference first."""
        return list(next(iter(self.arms.values())).index)

    @property
    def first(self) -> Metric:
        """The metric in which arms are shown first: the stated one, or the best fitness where none is known."""
        return self.primary if self.primary is not None and self.primary in self.arms else Metric.best_fitness

    @property
    def unequal_twins(self) -> list[tuple[str, str]]:
        """Pairs of runs, by their jobs, that must be one search, by their arms' settings and their seed, and differ.

        One of both is then not what its settings give: other code made it, or a machine that computes otherwise.
        """
        by_arm = {arm: rows.reset_index() for arm, rows in self.jobs.groupby("arm")}
        pairs = [
            by_arm[one].merge(by_arm[other], on="seed") for one, other in self.twins if {one, other} <= by_arm.keys()
        ]
        return [(row.job_x, row.job_y) for both in pairs for row in both.itertuples() if row.search_x != row.search_y]

    def values(self, arm: str, metric: Metric) -> dict[int, float]:
        """Return an arm's known values by seed, rising."""
        return samples_of(self.jobs, metric).get(arm, {})


def jobs_frame(finished: Sequence[FinishedJob], curves: pd.DataFrame) -> pd.DataFrame:
    """Measure finished runs, one a row (`JOBS`); `curves` as of `curves_frame`."""
    ends = curves.groupby("job").last()
    return as_jobs(
        {"job": one.job.name, "arm": one.job.arm, "seed": one.job.seed, "search": slots_of(one.run)}
        | {metric.name: value for metric, value in _values(one).items()}
        | {name: ends.at[one.job.name, name] for name in ("qd_score", "coverage")}
        for one in finished
    )


def as_jobs(rows: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Return a frame of jobs (`JOBS`); what a row does not have is missing.

    `search` may be anything that is equal for jobs that are one and the same search; it becomes a number.
    """
    given = list(rows)
    searches = [row["search"] for row in given]
    numbered = [{**row, "search": searches.index(row["search"])} for row in given]
    return pd.DataFrame(numbered, columns=["job", *JOBS]).set_index("job").astype(JOBS)


def curves_frame(finished: Sequence[FinishedJob], common: CommonArchive) -> pd.DataFrame:
    """Return a row for each job and generation: arm, seed, and best fitness, coverage and QD-score of all until then.

    A run that its FLOPs ended before others stays where it ended. Best fitness is NaN before anything was trained.
    """
    each = [
        filled(one.run, common).assign(best_fitness=[line.best for line in one.run.generations]) for one in finished
    ]
    longest = max(map(len, each))
    whole = [
        frame.reindex(range(longest), method="ffill").assign(job=one.job.name, arm=one.job.arm, seed=one.job.seed)
        for one, frame in zip(finished, each, strict=True)
    ]
    return pd.concat(whole).rename_axis("generation").reset_index().astype({"best_fitness": "float64"})


def by_generation(curves: pd.DataFrame, arm: str, metric: Metric) -> NDArray[np.float64]:
    """Return the curves of an arm's seeds, shape (seeds, generations)."""
    own = curves[curves.arm == arm].pivot(index="job", columns="generation", values=metric.name)
    return np.asarray(own, dtype=np.float64)


def compare_arms(
    jobs: pd.DataFrame,
    *,
    requested_reference: str = REFERENCE,
    primary: Metric | None = None,
    failed: Sequence[Job] = (),
    twins: Sequence[tuple[str, str]] = (),
    not_tested: Collection[str] = (),
) -> Ablation:
    """Summarise every arm, and compare it with the reference.

    For the bootstrap, each arm and metric has a stream of its own, so equal values have equal intervals, whatever other
    arms there are.

    Args:
        jobs: the runs (`JOBS`).
        requested_reference: the arm to compare with.
        primary: the metric that the sweep states.
        failed: jobs without a run, or without a test score, because they failed. Compared is what an arm comes to with
            them: in tests, effect sizes and differences each counts as worse than any other job. Otherwise an arm would
            be the better for every job that it loses.
        twins: pairs of arms that are one search by construction. Where one of both is the reference, nothing is tested,
            and the other is not in Holm's family.
        not_tested: arms that have no test scores, as the sweep states; in these they are in no family, either.
    """
    names = sorted(
        dict.fromkeys([*jobs.arm, *(job.arm for job in failed)]), key=lambda name: name != requested_reference
    )
    reference = requested_reference if requested_reference in set(jobs.arm) else None
    shown = [metric for metric in Metric if metric not in TESTED or jobs[metric.name].notna().any()]
    same, arms = twins_of(requested_reference, twins), {}
    for metric in shown:
        out = not_tested if metric in TESTED else ()
        lost = [job for job in failed if job.arm not in out]
        arms[metric] = _arms(jobs, metric, names, reference=reference, failed=lost, twins=same, out=out)
    return Ablation(
        reference=reference, requested_reference=requested_reference, primary=primary, jobs=jobs, twins=twins, arms=arms
    )


def _values(job: FinishedJob) -> dict[Metric, float | None]:
    run, tested = job.run, job.tested
    gains, spent = improvement(run), spending(run, run.candidates)
    return {
        **({} if tested is None else {TESTS[tested.metric]: tested.value, Metric.test_loss: tested.loss}),
        Metric.best_fitness: gains.get("last"),
        Metric.new_quartile: gains.get("new_quartile"),
        Metric.new_median: gains.get("new_median"),
        Metric.improvement: _rounded(gains.get("over_first")),
        Metric.improvement_over_baseline: _rounded(gains.get("over_baseline")),
        Metric.trainable: _rounded(gains.get("trainable")),
        Metric.candidates: len(run.candidates),
        Metric.evaluations: len({one.evaluation for one in run.candidates} - {None}),
        Metric.training_flops: rounded(spent_on_training(run) / 1e12),
        Metric.tokens: None if spent is None else spent.tokens,
        Metric.cost: None if spent is None or spent.unpriced else rounded(spent.usd),
    }


def _rounded(value: float | None) -> float | None:
    return None if value is None else rounded(value)


def slots_of(run: RecordedRun) -> tuple[CandidateLine, ...]:
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


def samples_of(jobs: pd.DataFrame, metric: Metric) -> dict[str, dict[int, float]]:
    """Return the known values of each arm by seed, rising."""
    known = jobs.dropna(subset=metric.name).sort_values("seed").astype({metric.name: "float64"})
    return {arm: dict(zip(rows.seed, rows[metric.name], strict=True)) for arm, rows in known.groupby("arm")}


def _with_failed(
    samples: Mapping[str, Mapping[int, float]], metric: Metric, lost: Iterable[tuple[str, int]]
) -> dict[str, dict[int, float]]:
    """Add the jobs that failed to the samples, next to the worst value that any job has: last in rank, and finite."""
    whole = {arm: dict(sample) for arm, sample in samples.items()}
    every = [value for sample in samples.values() for value in sample.values()]
    if every:
        is_less = metric in LESS_IS_BETTER
        worst = math.nextafter(max(every), math.inf) if is_less else math.nextafter(min(every), -math.inf)
        for arm, seed in lost:
            whole.setdefault(arm, {})[seed] = worst
    return {arm: dict(sorted(sample.items())) for arm, sample in whole.items()}


def _arms(
    jobs: pd.DataFrame,
    metric: Metric,
    names: Sequence[str],
    *,
    reference: str | None,
    failed: Sequence[Job],
    twins: Collection[str],
    out: Collection[str],
) -> pd.DataFrame:
    """Summarise all arms in one metric, and compare them with the reference (`ARMS`)."""
    samples = samples_of(jobs, metric)
    rows: dict[str, dict[str, Any]] = {name: {"runs": int((jobs.arm == name).sum())} for name in names}
    for name in names:
        values = list(samples.get(name, {}).values())
        rows[name] |= {"n": len(values), "median": rounded(float(np.median(values))) if values else None}
        rows[name] |= _ends("median", values)
    if reference is not None:
        searches = {arm: dict(zip(one.seed, one.search, strict=True)) for arm, one in jobs.groupby("arm")}
        # One whose search ended failed its test, and what a search used is no worse for a failure.
        lost = {(job.arm, job.seed) for job in failed} if metric not in SPENT else set()
        if metric not in TESTED:
            lost -= set(zip(jobs.arm, jobs.seed, strict=True))
        for arm, at in lost:
            searches.setdefault(arm, {}).setdefault(at, math.nan)  # equal to no other's
        whole = _with_failed(samples, metric, sorted(lost))
        samples = {name: whole.get(name, {}) for name in names}
        _contrast(rows, samples, searches, metric=metric, twins=twins, out=out)
    frame = pd.DataFrame(list(rows.values()), index=pd.Index(names, name="arm"), columns=list(ARMS))
    return frame.astype(ARMS)


def _contrast(
    rows: Mapping[str, dict[str, Any]],
    samples: Mapping[str, Mapping[int, float]],
    searches: Mapping[str, Mapping[int, float]],
    *,
    metric: Metric,
    twins: Collection[str],
    out: Collection[str],
) -> None:
    """Compare the samples of all other arms with the first's, and add what was found to their rows."""
    pairs: dict[str, tuple[list[float], list[float]]] = {}
    for name, (kind, differing, x, y) in _compared(samples, searches, twins, out).items():
        if kind is Comparability.comparable:
            pairs[name] = list(x.values()), list(y.values())
        rows[name] |= {"comparability": kind.value, "differing": differing}
        rows[name] |= {"n_arm": len(x), "n_reference": len(y)} | _by_seed(metric, x, y)
    family = _family(samples, {*twins, *out})
    tests = {name: mann_whitney(*pair) for name, pair in pairs.items()}
    p_holm = _corrected(family, {name: test.p for name, test in tests.items()})
    least = _corrected(family, {name: smallest_p(*map(len, pair)) for name, pair in pairs.items()})
    for name, test in tests.items():
        rows[name] |= {"u": test.u, "p": test.p, "p_holm": p_holm[name], "method": test.method.value}
        rows[name] |= effects(*pairs[name], rng=stream(0, "effects", name, metric.name))
        rows[name]["cautions"] = cautions(*pairs[name], method=test.method, least_p=least[name], alpha=ALPHA)


def corrected_p(
    samples: Mapping[str, Mapping[int, float]],
    searches: Mapping[str, Mapping[int, float]],
) -> dict[str, float]:
    """Return the p after Holm of every arm but the first, the reference, as `compare_arms`; 1 where nothing is tested.

    Args:
        samples: of each arm, the known values by seed.
        searches: of each arm, by seed, numbers that are equal where two searches are.
    """
    compared = _compared(samples, searches, (), ()).items()
    tested = {
        name: mann_whitney(list(x.values()), list(y.values())).p
        for name, (kind, _, x, y) in compared
        if kind is Comparability.comparable
    }
    return dict.fromkeys([*samples][1:], 1.0) | _corrected(_family(samples, ()), tested)


def _compared(
    samples: Mapping[str, Mapping[int, float]],
    searches: Mapping[str, Mapping[int, float]],
    twins: Collection[str],
    out: Collection[str],
) -> dict[str, tuple[Comparability, int, dict[int, float], dict[int, float]]]:
    """Return, by arm, whether it is tested, how many runs differ from the reference's, and both samples of these."""
    reference, *others = samples
    compared = {}
    for name in others:
        same = {at for at, search in searches.get(name, {}).items() if searches[reference].get(at) == search}
        x, y = ({at: sample[at] for at in sample if at not in same} for sample in (samples[name], samples[reference]))
        differing = len(searches.get(name, {})) - len(same)
        kind = Comparability.by_construction if name in twins else Comparability.not_tested
        if name not in twins and name not in out:
            few = min(len(samples[name]), len(samples[reference]))
            kind = _comparability(x, y, few=few, equal=bool(same) and not differing)
        compared[name] = kind, differing, x, y
    return compared


def _family(samples: Mapping[str, Mapping[int, float]], out: Collection[str]) -> list[str]:
    """List the arms of Holm's family, without those that are left `out`.

    An arm that has seeds enough and is not tested counts with p = 1, so that the family's size does not depend on what
    the runs found. One that is the reference by construction does not, nor one that has no test scores: that was known
    before.
    """
    reference, *others = samples
    enough = {name for name, sample in samples.items() if len(sample) >= FEWEST_SEEDS}
    return [name for name in others if name not in out and {name, reference} <= enough]


def _corrected(family: Sequence[str], p_values: Mapping[str, float]) -> dict[str, float]:
    """Correct p-values by arm after Holm; the family may be empty."""
    return dict(zip(family, holm([p_values.get(name, 1.0) for name in family]), strict=True)) if family else {}


def _comparability(x: Mapping[int, float], y: Mapping[int, float], *, few: int, equal: bool) -> Comparability:
    """Return whether a sample can be tested against the reference's, by seed both, of the runs that differ.

    `few` is the smaller size of both samples with those that do not differ, and `equal` whether there are runs of the
    arm, none of which differs.
    """
    if equal:
        return Comparability.identical
    if few >= FEWEST_SEEDS and (x == y or len({*x.values(), *y.values()}) == 1):
        return Comparability.equal_values
    if few < FEWEST_SEEDS:
        return Comparability.too_few_seeds
    return Comparability.too_few_differ if min(len(x), len(y)) < FEWEST_SEEDS else Comparability.comparable


def _by_seed(metric: Metric, x: Mapping[int, float], y: Mapping[int, float]) -> dict[str, Any]:
    """Return the median of the differences x - y on shared seeds, and on how many x is better, equal and worse."""
    differences = [x[at] - y[at] for at in sorted(x.keys() & y.keys())]
    lower, higher = sum(value < 0 for value in differences), sum(value > 0 for value in differences)
    better, worse = (lower, higher) if metric in LESS_IS_BETTER else (higher, lower)
    counts = {"better": better, "equal": len(differences) - better - worse, "worse": worse}
    return counts | _ends("by_seed", differences)


def _ends(name: str, values: Sequence[float]) -> dict[str, float]:
    """Return a median with the ends of its interval as columns; none below two values."""
    return median(values).columns(name) if len(values) >= FEWEST_SEEDS else {}
