"""The places of a run's candidates in behaviour space, under the bounds that its archive ended with."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from tacevo.choices import BoundsRule, Scale
from tacevo.evolution.archive import Tessellation
from tacevo.results.run import RecordedRun, descriptors_of
from tacevo.rounding import rounded

#: Points a side of the lattice that looks for niches; 200 x 200 put 400 points into a niche of the default 100.
LATTICE = 200

#: The names of the descriptors, short and in full.
AXES = {"arch_div": ("ArchDiv", "Architectural Diversity"), "eff_ratio": ("EffRatio", "Efficiency Ratio")}

#: What networks are at the low and at the high end of each descriptor.
DIRECTIONS = {"arch_div": ("plain", "varied"), "eff_ratio": ("few FLOPs a parameter", "many")}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoverageMap:
    """The places of a run's trained candidates, in the order of the run, and what moved the bounds."""

    #: Normalised descriptors, shape (candidates, axes), in [0, 1].
    points: NDArray[np.float64]
    #: Niche of each of them, shape (candidates,).
    niches: NDArray[np.int64]
    #: Part of them that lies outside the bounds and was clipped, in [0, 1]; 0 under bounds that adapt.
    clipped: float
    #: Generation of each candidate that moved the bounds after the first one, in order.
    moved: tuple[int, ...]


def coverage_map(run: RecordedRun, centroids: NDArray[np.float64]) -> CoverageMap:
    """Place the trained candidates of a run.

    The centroids are those of its network archive, shape (niches, axes), in [0, 1].

    Raises:
        ValueError: nothing was trained, or its archive has no niches.
    """
    if run.bounds is None:
        raise ValueError(f"{run.path} has no bounds, because nothing was trained or its archive has no niches")
    raw = descriptors(run)
    points = np.array([run.bounds.normalise(tuple(point)) for point in raw.tolist()])
    outside = ((raw < np.array(run.bounds.low)) | (raw > np.array(run.bounds.high))).any(axis=1)
    tessellation = Tessellation(centroids)
    return CoverageMap(
        points=points,
        niches=np.array([tessellation.niche_of(point) for point in points.tolist()], dtype=np.int64),
        clipped=float(outside.mean()),
        moved=() if run.config.archive.bounds is BoundsRule.fixed else _moves(run, raw),
    )


def descriptors(run: RecordedRun) -> NDArray[np.float64]:
    """Return the descriptors of the trained candidates as the archive's axes have them, shape (candidates, axes)."""
    scale, axes = run.config.archive.eff_ratio_scale, run.config.archive.axes
    return np.array([descriptors_of(candidate, scale, axes) for candidate in run.trained]).reshape(-1, len(axes))


def axis_label(axis: str, scale: Scale, logarithm: str = "log10") -> str:
    """Return the label of an axis, of which the Efficiency Ratio's can be logarithmic."""
    name = AXES.get(axis, (axis, axis))[1]
    return f"{logarithm} {name}" if axis == "eff_ratio" and scale is Scale.log else name


def reachable(known: CoverageMap, centroids: NDArray[np.float64]) -> frozenset[int]:
    """Find the niches that networks between those of the run would fall into.

    A niche counts as reachable if a candidate fell into it, or if a point of a fine lattice does that lies in the
    convex hull of the candidates; with one axis, between the lowest and the highest. The hull is a generous guess, as
    mixtures of two networks need not exist; what lies outside of it, no network of the run suggests.

    The centroids have the shape (niches, axes), in [0, 1].
    """
    return frozenset(known.niches.tolist()).union(Tessellation(centroids).niches_of(_between(known.points).tolist()))


def _between(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points of the lattice that lie in the convex hull of points, shape (found, axes)."""
    side = (np.arange(LATTICE) + 0.5) / LATTICE
    if points.shape[1] == 1:
        line: NDArray[np.float64] = side[(side >= points.min()) & (side <= points.max())]
        return line.reshape(-1, 1)
    lattice = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    try:
        sides = ConvexHull(points).equations
    except (QhullError, ValueError):  # fewer than three candidates, or all on a line: there is nothing between them
        return lattice[:0]
    return lattice[np.all(lattice @ sides[:, :2].T + sides[:, 2] <= 0, axis=1)]


def fullest_tenth(values: NDArray[np.float64], span: tuple[float, float]) -> float:
    """Return the part of values, shape (n,), that lies in the fullest of ten equal parts of a span, in [0.1, 1]."""
    return rounded(np.histogram(values, bins=10, range=span)[0].max() / len(values))


def effective_niches(known: CoverageMap) -> float:
    """Return the number of equally full niches that would be as uneven: 2 to the entropy of the candidates' niches."""
    counts = np.unique(known.niches, return_counts=True)[1]
    shares = counts / counts.sum()
    return rounded(2.0 ** -(shares * np.log2(shares)).sum())


def _moves(run: RecordedRun, raw: NDArray[np.float64]) -> tuple[int, ...]:
    """Find the candidates outside all before them; each rebuilt the archive."""
    generations = [candidate.generation for candidate in run.trained]
    low, high = np.minimum.accumulate(raw), np.maximum.accumulate(raw)
    moved = ((low[1:] != low[:-1]) | (high[1:] != high[:-1])).any(axis=1)
    return tuple(generation for generation, moves in zip(generations[1:], moved.tolist(), strict=True) if moves)
