"""All that is known of a sweep: its runs, the archive that measures them, their comparison; its tables."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from analysis.report.outputs import Outputs, Say, outputs, unsaid
from analysis.runs.niches import load_niches
from analysis.sweeps.ablation import Ablation, compare_arms, curves_frame, jobs_frame
from analysis.sweeps.arm_metrics import TESTS, Metric
from analysis.sweeps.common_archive import common_archive, extents
from analysis.table import Table
from analysis.tables.ablation import ablation_tables, common_note, extents_note
from tacevo.choices import PAPER_AXES, Primary
from tacevo.errors import ConfigError, IncomparableError
from tacevo.results.run import RecordedRun
from tacevo.results.study import PRIMARY
from tacevo.results.sweep import REFERENCE, FinishedJob, RecordedSweep, load_sweep
from tacevo.results.sweep_checks import check_sweep
from tacevo.text import counted


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SweepCollection:
    """A sweep with its comparison."""

    sweep: RecordedSweep
    ablation: Ablation
    #: Of its runs, by generation (`curves_frame`).
    curves: pd.DataFrame
    #: Name of the job whose niches the common archive has.
    niches_of: str
    #: Of the common archive (`analysis.sweeps.common_archive.EXTENTS`).
    extents: pd.DataFrame


def collect_sweep(
    path: Path, store: Path | None, reference: str | None = None, known: Mapping[str, RecordedRun] | None = None
) -> SweepCollection:
    """Read the finished jobs of a sweep and compare its arms.

    Args:
        path: the directory of the sweep.
        store: where the stores of its runs lie, if not where the runs had them.
        reference: the arm to compare with; None for the one that the sweep states, or else `none`.
        known: finished runs that were read already, by their jobs' names.

    Raises:
        ConfigError: the reference is not an arm of the sweep.
        IncomparableError: its jobs cannot be compared, or none has niches over both descriptors.
        RunError: it does not hold a sweep with a finished job, or one of them was edited.
    """
    sweep = load_sweep(path, known)
    check_sweep(sweep)
    _check_arm(sweep, reference)
    requested_reference = reference or sweep.terms.reference or REFERENCE
    measure, runs = measuring(sweep, requested_reference), [one.run for one in sweep.finished]
    niches = load_niches(measure.run if store is None else measure.run.with_store(str(store)))
    common = common_archive(runs, measure.run, niches.networks)
    curves = curves_frame(sweep.finished, common)
    jobs = jobs_frame(sweep.finished, curves)
    ablation = compare_arms(
        jobs,
        requested_reference=requested_reference,
        primary=primary_metric(sweep),
        failed=sweep.failed,
        twins=sweep.twins,
        not_tested=sweep.not_tested,
    )
    return SweepCollection(
        sweep=sweep,
        ablation=ablation,
        curves=curves,
        niches_of=measure.job.name,
        extents=extents(runs, common),
    )


def primary_metric(sweep: RecordedSweep) -> Metric | None:
    """Return what the arms are compared by first; None where the sweep states nothing of it.

    Once it states how its jobs are tested, that is the test score, unless it stated another metric when it began.
    """
    stated = sweep.terms.primary
    if stated is None:
        if sweep.terms.retraining is None:
            return None
        stated = Primary.test_score
    return TESTS[PRIMARY[sweep.finished[0].run.facts.kind]] if stated is Primary.test_score else Metric[stated.name]


def _check_arm(sweep: RecordedSweep, reference: str | None) -> None:
    arms = {one.job.arm for one in sweep.finished} | {one.job.arm for one in sweep.missing}
    if reference is not None and reference not in arms:
        expected = f"one of the arms: {', '.join(map(repr, sorted(arms)))}"
        raise ConfigError(repr(reference), place="--reference", expected=expected)


def measuring(sweep: RecordedSweep, requested_reference: str = REFERENCE) -> FinishedJob:
    """Choose the job in whose niches all are measured: the first with some over both descriptors, the reference first.

    Raises:
        IncomparableError: no job has such niches.
    """
    for one in sorted(sweep.finished, key=lambda one: one.job.arm != requested_reference):
        if one.run.has_niches and one.run.config.archive.axes == PAPER_AXES:
            return one
    raise IncomparableError(
        f"{counted(len(sweep.finished), 'finished job')} without one",
        place=str(sweep.path),
        expected="a finished job with an archive over both descriptors, in whose niches all runs are measured",
        remedy=f"add the arm {requested_reference} to the sweep",
    )


def sweep_tables(collected: SweepCollection, installed: Outputs | None = None, say: Say = unsaid) -> tuple[Table, ...]:
    """Return every table of a sweep, those of outputs last: of ours, unless others are given; `say` as of a run's."""
    known = outputs(ours=True) if installed is None else installed
    archive = f"{common_note(collected.niches_of)} {extents_note(collected.extents)}"
    return (*ablation_tables(collected.sweep, collected.ablation, archive), *known.sweep_tables(collected, say))
