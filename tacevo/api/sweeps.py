"""A sweep: its jobs, and its arms compared."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.report.outputs import outputs
from analysis.report.sweep_collection import SweepCollection, collect_sweep, sweep_tables
from analysis.sweeps.ablation import Ablation
from analysis.sweeps.arm_metrics import TESTED, TESTS, Metric
from analysis.table import Table as Rows
from analysis.tables.ablation import divergence
from tacevo.api import frames
from tacevo.api.replaying import digest_of, replay
from tacevo.api.runs import Draw, Run, progress
from tacevo.api.tables import Named, Table
from tacevo.bundles.open import Opened, located
from tacevo.choices import Primary
from tacevo.errors import CacheMissError, ConfigError
from tacevo.parts.registry import needing_parts
from tacevo.results.run import RecordedRun
from tacevo.results.sweep import Standing, state_of
from tacevo.runs.profiles import recall_profiles
from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.text import listed, nearest

if TYPE_CHECKING:
    import pandas as pd

    from analysis.sweeps.pairs import Pairs


class Sweep:
    """A sweep of runs; of a directory, those of its jobs that are finished."""

    def __init__(self, name: str, place: Opened, store: str | None) -> None:
        #: The name of the sweep's directory, or of its bundle without the ending.
        self.name = name
        #: The place of the sweep: a directory or a bundle.
        self.place = place
        #: The directory of the stores, where it was moved; None for the sweep's own.
        self.store = store
        self._record = SweepDirectory(place.folder).read()
        #: The records of the sweep by the reference that was asked for; None for the sweep's own.
        self._collected: dict[str | None, SweepCollection] = {}

    @property
    def arms(self) -> tuple[str, ...]:
        """The names of its arms, in the order of its jobs."""
        return tuple(dict.fromkeys(job.arm for job in self._record.jobs))

    @property
    def jobs(self) -> pd.DataFrame:
        """A row a job by name: arm, seed, state, a column for each metric; columns: docs/python.md.

        `state` is `finished`, `running`, `failed`, `stopped` or `not begun`, as `tacevo show` has it; only a finished
        job has values.
        """
        collected = self.collection()
        missing = {one.job.name: one for one in collected.sweep.missing}
        digests = {one.job.name: one.run.digest for one in collected.sweep.finished}
        rows = []
        for job in self._record.jobs:
            row: dict[str, Any] = {"job": job.name, "arm": job.arm, "seed": job.seed, "state": "finished"}
            if (one := missing.get(job.name)) is not None:
                row |= {"state": one.standing.value, "reason": one.reason or None}
            rows.append(row | {"digest": digests.get(job.name)})
        metrics = [metric.name for metric in collected.ablation.arms]
        return frames.frame(rows, frames.JOBS, index="job").join(collected.ablation.jobs[metrics])

    def contrasts(self, metric: str | None = None, *, reference: str | None = None) -> pd.DataFrame:
        """Compare the arms in one metric; a row an arm, the reference first; columns: docs/python.md.

        An arm without a finished job has no row; `frame.attrs["left_out"]` says which, a sentence each.

        Args:
            metric: a column of `jobs`, such as `qd_score`; or its name in the tables, such as `QD-score`; or
                `test_score`, whichever the task has. If None, what the sweep states that arms are compared by first.
            reference: the arm that the others are compared with; the sweep's own if None.

        Raises:
            ConfigError: there is no such metric or arm; or no job has a value of it yet; or the sweep states none.
            IncomparableError: the jobs cannot be compared.
        """
        collected = self.collection(reference)
        compared = collected.ablation
        looked_up = any(one.run.config.data.facts.is_looked_up for one in collected.sweep.finished)
        frame = compared.arms[metric_of(metric, compared, looked_up=looked_up)].copy()
        frame.attrs["left_out"] = self._arms_left_out()
        return frame

    def run(self, job: str) -> Run:
        """Open the run of a finished job.

        Raises:
            ConfigError: the sweep has no such job.
            RunError: it is not finished.
        """
        names = [one.name for one in self._record.jobs]
        if job not in names:
            expected = f"one of {listed(names)}"
            raise ConfigError(repr(job), place="job", expected=expected, remedy=nearest(job, names, ""))
        place = self.place.job(job) if self.place.digest is not None else located(self.place.folder / job)
        return Run(place, place.read(place.folder, self.store))

    @cached_property
    def runs(self) -> tuple[Run, ...]:
        """The runs of its finished jobs, in their order."""
        directory = SweepDirectory(self.place.folder)
        return tuple(
            self.run(job.name)
            for job in self._record.jobs
            if self.place.digest is not None or state_of(directory, job)[0] is Standing.finished
        )

    @property
    def left_out(self) -> tuple[str, ...]:
        """The arms without a row, and the jobs without a result or a test score, with the reason, a sentence each.

        First, if it is so, that runs differ which must be one search.
        """
        sweep = self.collection().sweep
        loud = [divergence(pairs)] if (pairs := self.collection().ablation.unequal_twins) else []
        jobs = (f"left out: {one.job.name}: {one.why}" for one in sweep.missing)
        untested = (f"without a test score: {one.job.name}: {one.reason}" for one in sweep.untested)
        return (*loud, *self._arms_left_out(), *jobs, *untested)

    def _arms_left_out(self) -> tuple[str, ...]:
        """Name the arms that no job finished of."""
        sweep = self.collection().sweep
        known = {one.job.arm for one in sweep.finished} | {job.arm for job in sweep.failed}
        return tuple(f"left out: arm {arm}: no seed of it is finished yet" for arm in self.arms if arm not in known)

    def all_tables(self, reference: str | None = None) -> tuple[tuple[Rows, ...], list[str]]:
        """Return its tables, compared with an arm or the sweep's own reference; and why others are missing.

        Raises:
            ConfigError: the reference is not an arm.
            RunError, IncomparableError: as `collection`.
        """
        known = outputs()
        missing = list(known.missing.values())
        return sweep_tables(self.collection(reference), known, missing.append), missing

    @cached_property
    def tables(self) -> Mapping[str, Table]:
        """Every table of `tacevo ablations` by name."""
        tables, missing = self.all_tables()
        return Named({table.name: Table(table) for table in tables}, "sweep.tables", missing)

    @needing_parts()
    def pairs(self, reference: str | None = None, *, other_parents: bool = False) -> Pairs:
        """Compare its arms answer by answer, where they ask the same questions (docs/pairs.md).

        Args:
            reference: the arm that the others are compared with; None for the one that the sweep states, else `none`.
            other_parents: whether questions also count as the same whose parents are other networks, at the same
                places of generation 0: so arms compare that differ by `search.networks`.

        Returns:
            The comparison: `arms` and `answers` are frames, and `diversity` where questions were asked several times.

        Raises:
            ConfigError: the reference is not an arm with a finished search.
            RunError: no two arms ask the same question.
        """
        from analysis.sweeps.pairs import compare_pairs

        sweep = self.collection().sweep
        return compare_pairs(sweep, reference, other_parents=other_parents, operations=_operations)

    @cached_property
    @needing_parts()
    def figures(self) -> Mapping[str, Draw]:
        """Every figure of `tacevo ablations` by name; each is a function that draws a Matplotlib figure."""
        from analysis.report.figure_list import sweep_pictures, with_others  # Matplotlib takes a second to import

        missing: list[str] = []
        brought = outputs().sweep_figures(self.collection(), missing.append)
        pictures = with_others(sweep_pictures(self.collection()), brought, missing.append)
        return Named({picture.name: picture.draw for picture in pictures}, "sweep.figures", missing)

    @needing_parts()
    def replay(self, *, trust_parts: bool = False, quiet: bool = False) -> str:
        """Run every search and study again, as `Run.replay`; return the digest of the sweep."""
        place = self.place if self.place.digest is not None else located(self.place.folder)
        with progress(quiet) as view:
            return digest_of(place, replay(place, self.store, view, trusts=trust_parts))

    def collection(self, reference: str | None = None) -> SweepCollection:
        """The records of the sweep: its runs, the archive that measures them, their comparison with the reference.

        Raises:
            RunError: no job is finished, or one of them was edited.
            IncomparableError: the jobs cannot be compared.
        """
        if reference not in self._collected:
            place = self.place
            own = place.store if place.digest is not None else None
            store = own if self.store is None else Path(self.store)
            known = {run.path.name: run.recorded for run in self.runs}
            self._collected[reference] = collect_sweep(place.folder, store, reference, known)
        return self._collected[reference]

    def __repr__(self) -> str:
        return f"<sweep {self.name}: {len(self._record.jobs)} jobs of {len(self.arms)} arms>"

    def _repr_html_(self) -> str:
        title = f"sweep {self.name}: {len(self._record.jobs)} jobs of {len(self.arms)} arms"
        return f"<p>{title}</p>{self.jobs.to_html(na_rep='')}"


def _operations(run: RecordedRun) -> dict[str, Counter[str]] | None:
    """Count the operations that each trained candidate of a run calls, by id; None where its probes are not here."""
    try:
        profiles = recall_profiles(run)
    except CacheMissError:
        return None
    return {name: Counter(step.op for step in profile.steps) for name, profile in profiles.items()}


def metric_of(name: str | None, compared: Ablation, *, looked_up: bool = False) -> Metric:
    """Find a metric by its column in `jobs`, by its name in the tables or in the terms; None is the terms' own.

    Runs that were looked up in a table (`looked_up`) have no test scores, and get none.

    Raises:
        ConfigError: there is none of this name, or the sweep states none.
    """
    known = {word: metric for metric in compared.arms for word in (metric.name, metric.value)}
    for metric in TESTS.values():
        if metric in compared.arms:
            known[Primary.test_score.value] = metric
    wanted = compared.primary.name if name is None and compared.primary is not None else name
    if wanted in known:
        return known[wanted]
    is_test = wanted in {Primary.test_score, *(metric.name for metric in TESTED)}
    if is_test and looked_up:
        otherwise = "a table has no test images: compare by another, such as new_quartile"
    else:
        otherwise = "`tacevo study sweep=SWEEP` gives test scores" if is_test else "sweep.jobs has a column for each"
    raise ConfigError(
        "none, and the sweep states none" if wanted is None else repr(wanted),
        place="metric",
        expected=f"one of {listed(metric.name for metric in compared.arms)}",
        remedy=otherwise if is_test or wanted is None else nearest(wanted, known, otherwise),
    )
