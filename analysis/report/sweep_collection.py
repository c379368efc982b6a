"""All that is known of a sweep: its runs, the archive that measures them, their comparison; its tables."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.runs.niches import load_niches
from analysis.runs.run import Run
from analysis.sweeps.ablation import Ablation, compare_arms, outcome
from analysis.sweeps.common_archive import Extent, common_archive, extents
from analysis.sweeps.sweep import REFERENCE, Finished, Sweep, load_sweep
from analysis.sweeps.sweep_checks import check_sweep
from analysis.table import Table
from analysis.tables.ablation import ablation_tables, common_note, extents_note
from tacevo.errors import IncomparableError


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepCollection:
    """A sweep with its comparison."""

    sweep: Sweep
    found: Ablation
    #: Name of the job whose niches the common archive has.
    niches_of: str
    #: Of the common archive, by axis.
    extents: tuple[Extent, ...]


def collect_sweep(path: Path, store: Path | None) -> SweepCollection:
    """Read the finished jobs of a sweep and compare its arms.

    Args:
        path: the directory of the sweep.
        store: where the stores of its runs lie, if not where the runs had them.

    Raises:
        IncomparableError: its jobs cannot be compared, or none has niches over both descriptors.
        RunError: it does not hold a sweep with a finished job, or one of them was edited.
    """
    sweep = load_sweep(path)
    check_sweep(sweep)
    measure, centroids = measuring(sweep, lambda run: load_niches(run, store).networks)
    runs = [one.run for one in sweep.finished]
    common = common_archive(runs, measure.run, centroids)
    found = compare_arms([outcome(one, common) for one in sweep.finished])
    return SweepCollection(sweep=sweep, found=found, niches_of=measure.job.name, extents=extents(runs, common))


def measuring(sweep: Sweep, centroids_of: Callable[[Run], NDArray[np.float64]]) -> tuple[Finished, NDArray[np.float64]]:
    """Choose the job in whose niches all are measured: the first that has some over both descriptors, `none` first.

    Args:
        sweep: the sweep.
        centroids_of: gives the centroids of a run's network archive, shape (niches, axes), in [0, 1].

    Returns:
        The job, and its centroids.

    Raises:
        IncomparableError: no job has such niches.
    """
    for one in sorted(sweep.finished, key=lambda one: one.job.arm != REFERENCE):
        centroids = centroids_of(one.run)
        if len(centroids) and centroids.shape[1] == 2:
            return one, centroids
    raise IncomparableError(
        "none",
        place=str(sweep.path),
        expected="a finished job with an archive over both descriptors, in whose niches all runs are measured",
        remedy=f"add the arm {REFERENCE} to the sweep",
    )


def sweep_tables(collected: SweepCollection) -> tuple[Table, ...]:
    """Return every table of a sweep."""
    archive = f"{common_note(collected.niches_of)} {extents_note(collected.extents)}"
    return ablation_tables(collected.sweep, collected.found, archive)
