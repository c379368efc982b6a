"""How large is a difference: effect sizes with bootstrap intervals.

All three are estimated from the same resamples, so that their intervals belong together. Intervals are percentile
intervals (Efron 1979): docs/statistics.md says why not BCa. A single median has an interval without resamples.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis.statistics.samples import Sample, checked
from tacevo.rounding import rounded

#: One less than 10,000, so that the ends of a 95 % interval are the 250th resample from either side.
RESAMPLES = 9_999

LEVEL = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """An estimate between the ends of its interval."""

    estimate: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Effects:
    """How a first sample x differs from a second one y."""

    #: P(x > y) + P(x = y) / 2, in [0, 1]; at 0.5 there is no difference.
    a12: Interval
    #: P(x > y) - P(x < y), in [-1, 1]; twice A12 less one.
    cliffs_delta: Interval
    #: Median of x less median of y, in the unit of the values.
    median_difference: Interval


def cliffs_delta(x: ArrayLike, y: ArrayLike) -> float:
    """Estimate P(x > y) - P(x < y) (Cliff 1993).

    Args:
        x: shape (n,), n >= 2.
        y: shape (m,), m >= 2.

    Raises:
        ValueError: a sample has another shape, or values that are not finite.
    """
    return float(_dominance(checked(x, name="x"), checked(y, name="y")).mean(dtype=np.float64))


def a12(x: ArrayLike, y: ArrayLike) -> float:
    """Estimate P(x > y) + P(x = y) / 2 (Vargha & Delaney 2000); arguments as of `cliffs_delta`."""
    return (1 + cliffs_delta(x, y)) / 2


def median_difference(x: ArrayLike, y: ArrayLike) -> float:
    """Return the median of x less the median of y; arguments as of `cliffs_delta`."""
    return float(np.median(checked(x, name="x")) - np.median(checked(y, name="y")))


def median(x: ArrayLike) -> Interval:
    """Estimate a median with the interval between two values of the sample, equally many from either end.

    It is the narrowest of these that holds the median of a continuous distribution with a chance of 95 % at least
    (the confidence interval of the sign test), and the whole range where none does: below six values. A bootstrap's
    percentiles promise 95 % and hold it in 87.5 % of samples of seven.

    Args:
        x: shape (n,), n >= 2.

    Raises:
        ValueError: the sample has another shape, or values that are not finite.
    """
    ordered = np.sort(checked(x, name="x"))
    cut = _cut(len(ordered))
    low, high = float(ordered[cut]), float(ordered[-1 - cut])
    return Interval(estimate=rounded(float(np.median(ordered))), low=rounded(low), high=rounded(high))


def median_confidence(n: int) -> float:
    """Return the chance that `median`'s interval of n >= 2 values holds the median; of tied values it is higher."""
    return _confidence(n, _cut(n))


def _cut(n: int) -> int:
    """Count the values that may be left out at either end of n; none where even all are too few."""
    return max([cut for cut in range(n // 2) if _confidence(n, cut) >= LEVEL], default=0)


def _confidence(n: int, cut: int) -> float:
    """Return the chance that more than `cut` of n values lie on either side of the median."""
    outside: int = 2 * sum(math.comb(n, below) for below in range(cut + 1))
    return float(1 - outside / 2**n)


def effects(x: ArrayLike, y: ArrayLike, *, rng: np.random.Generator, resamples: int = RESAMPLES) -> Effects:
    """Estimate all effects with their 95 % intervals.

    Values are drawn again within each sample, n of x and m of y, as its seeds were drawn. An interval's ends are
    resampled estimates themselves, so nothing is interpolated.

    Args:
        x: shape (n,), n >= 2.
        y: shape (m,), m >= 2.
        rng: gives the resamples; equal states give equal bits.
        resamples: at least 39, below which there is no 2.5 % on either side.

    Raises:
        ValueError: a sample has another shape or values that are not finite, or there are too few resamples.
    """
    first, second = checked(x, name="x"), checked(y, name="y")
    _check_resamples(resamples)
    from_first = rng.integers(len(first), size=(resamples, len(first)))
    from_second = rng.integers(len(second), size=(resamples, len(second)))
    drawn = _dominance(first, second)[from_first[:, :, None], from_second[:, None, :]]
    deltas = drawn.sum(axis=(1, 2), dtype=np.int64) / (len(first) * len(second))
    differences = np.median(first[from_first], axis=1) - np.median(second[from_second], axis=1)
    return Effects(
        a12=_interval(a12(first, second), (1 + deltas) / 2),
        cliffs_delta=_interval(cliffs_delta(first, second), deltas),
        median_difference=_interval(median_difference(first, second), differences),
    )


def _check_resamples(resamples: int) -> None:
    if resamples < 39:
        raise ValueError(f"a 95 % interval needs resamples >= 39; got {resamples}")


def _dominance(x: Sample, y: Sample) -> NDArray[np.int8]:
    """Return for each pair whether x is above (1), at (0) or below (-1) y, shape (n, m)."""
    above, below = x[:, None] > y[None, :], x[:, None] < y[None, :]
    return above.astype(np.int8) - below.astype(np.int8)


def _interval(estimate: float, drawn: Sample) -> Interval:
    """Cut equally much off both ends of the sorted resamples."""
    ends = np.sort(drawn)
    cut = round((1 - LEVEL) / 2 * (len(drawn) + 1))
    return Interval(estimate=rounded(estimate), low=rounded(float(ends[cut - 1])), high=rounded(float(ends[-cut])))
