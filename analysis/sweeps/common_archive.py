"""One archive for all runs of a sweep, so that their coverage and QD-score can be compared.

A run's own archive has bounds that follow its own candidates, and arms may have archives of other kinds: what each
ledger says of coverage and QD-score counts other niches. Here every trained candidate of a run is put, in order, into
one and the same tessellation under one and the same bounds. No search saw this archive; it only measures, as the
passive archives of quality-diversity studies do.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tacevo.choices import BoundsRule, Scale
from tacevo.evolution.archive import Archive, AxisBounds, Elite, Tessellation, coverage, insert, qd_score
from tacevo.results.run import RecordedRun, descriptors_of
from tacevo.rounding import rounded


@dataclass(frozen=True, slots=True, kw_only=True)
class CommonArchive:
    """The archive in which all runs are measured."""

    tessellation: Tessellation
    bounds: AxisBounds
    #: The scale of the Efficiency Ratio.
    scale: Scale
    #: True where the bounds are a setting, and not those of candidates.
    fixed: bool


#: The columns of what decides the axes of the common archive, an axis a row, and the type of each: its name and bounds;
#: the candidates that have the least and the greatest value, as RUN/NAME, none where the bounds are fixed; the part of
#: all trained candidates in the fullest of ten equal parts of the axis, in [0.1, 1].
EXTENTS = {"axis": "str", "low": "float64", "high": "float64"}
EXTENTS |= {"lowest": "object", "highest": "object", "fullest": "float64"}


def common_archive(
    runs: Sequence[RecordedRun], reference: RecordedRun, centroids: NDArray[np.float64]
) -> CommonArchive:
    """Make the archive that all runs are measured in.

    Args:
        runs: of the sweep, with at least one trained candidate together.
        reference: whose settings of the archive hold. Where its bounds are fixed, these are the common ones, too; else
            they are the least and greatest descriptors of all runs.
        centroids: of its network archive, shape (niches, 2), in [0, 1].
    """
    settings = reference.config.archive
    scale = settings.eff_ratio_scale
    given = reference.bounds if settings.bounds is BoundsRule.fixed else None
    points = [descriptors_of(candidate, scale) for run in runs for candidate in run.trained]
    low, high = (tuple(map(end, zip(*points, strict=True))) for end in (min, max))
    bounds = given or AxisBounds(low=low, high=high)
    return CommonArchive(tessellation=Tessellation(centroids), bounds=bounds, scale=scale, fixed=given is not None)


def extents(runs: Sequence[RecordedRun], common: CommonArchive) -> pd.DataFrame:
    """Name the candidates at the bounds of the common archive, and the crowd between them (`EXTENTS`).

    Bounds stay those from the least to the greatest, as in the archives of the searches; no quantile has to be chosen,
    and none hides what a search found. So one outlier can decide the coverage of all: this says which, and how much.
    """
    descriptors = {f"{run.name}/{one.id}": descriptors_of(one, common.scale) for run in runs for one in run.trained}
    rows = []
    for at, name in enumerate(("architecture diversity", f"efficiency ratio ({common.scale.value})")):
        ends = common.bounds.low[at], common.bounds.high[at]
        tenths = Counter(min(int(10 * common.bounds.normalise(point)[at]), 9) for point in descriptors.values())
        held = (
            () if common.fixed else tuple(one for one, point in descriptors.items() if point[at] == end) for end in ends
        )
        rows.append((name, *map(rounded, ends), *held, rounded(max(tenths.values()) / len(descriptors))))
    return pd.DataFrame(rows, columns=list(EXTENTS)).astype(EXTENTS)


def filled(run: RecordedRun, common: CommonArchive) -> pd.DataFrame:
    """Put the candidates of a run into the common archive, in order; return what it holds after each generation.

    Returns:
        By generation: `coverage`, the occupied part of its niches, in [0, 1]; `qd_score`, the sum of 1 / (1 + f) over
        its elites.
    """
    archive, rows, fitness = Archive(), {}, run.fitness
    for line in run.generations:
        for one in run.candidates:
            if one.generation == line.generation and one.id in fitness:
                niche = common.tessellation.niche_of(common.bounds.normalise(descriptors_of(one, common.scale)))
                archive, _ = insert(archive, niche, Elite(name=one.id, objective=-fitness[one.id]))
        occupied = rounded(coverage(archive, common.tessellation.niches))
        rows[line.generation] = {"coverage": occupied, "qd_score": rounded(qd_score(archive))}
    return pd.DataFrame.from_dict(rows, orient="index")
