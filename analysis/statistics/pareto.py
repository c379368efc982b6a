"""Points that no other one beats in everything, and how much of a box they cover; in each objective lower is better."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tacevo.rounding import rounded


def front(values: ArrayLike) -> NDArray[np.int64]:
    """Find the points that no other one dominates: is as good in everything and better in something.

    Of equal points the first one counts.

    Args:
        values: shape (n, m), lower is better.

    Returns:
        Their rows, lowest first objective first.
    """
    points = np.asarray(values, dtype=np.float64)
    kept: list[int] = []
    # Whatever dominates a point, or equals it and is earlier, comes before it in this order, which is stable.
    for row in np.lexsort(points.T[::-1]):
        if not (points[kept] <= points[row]).all(axis=1).any():
            kept.append(int(row))
    return np.array(kept, dtype=np.int64)


def hypervolume(values: ArrayLike, reference: Sequence[float]) -> float:
    """Measure which part of the box between the origin and a reference point some points dominate, in [0, 1].

    It is the hypervolume of Zitzler and Thiele (1998, PPSN V) of two objectives, over the area of the box. A point that
    is not better than the reference in both adds nothing.

    Args:
        values: shape (n, 2), at least 0, lower is better.
        reference: its two values, above 0.
    """
    points = np.asarray(values, dtype=np.float64).reshape(-1, 2) / np.asarray(reference, dtype=np.float64)
    inside = points[(points < 1).all(axis=1)]
    edge, area = 1.0, 0.0
    for across, up in inside[front(inside)]:  # from left to right, so each lies lower than the one before
        area += (1.0 - across) * (edge - up)
        edge = up
    return rounded(area)
