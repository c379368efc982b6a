"""The size of a difference: effect sizes with intervals.

A chance has Newcombe's interval, a difference of medians a percentile interval of bootstrap resamples (Efron 1979), and
a single median one of order statistics: docs/statistics.md says why.
"""

import math
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.stats import binomtest
from scipy.stats import t as student

from analysis.statistics.samples import Sample, checked
from analysis.table import Interval
from tacevo.rounding import rounded

#: One less than 10,000, so that the ends of a 95 % interval are the 250th resample from either side.
RESAMPLES = 9_999

LEVEL = 0.95


#: The columns of effect sizes of a first sample x and a second one y, each with the ends of its interval: A12, that is
#: P(x > y) + P(x = y) / 2, in [0, 1], at 0.5 there is no difference (Vargha & Delaney 2000); Cliff's delta (1993), that
#: is twice A12 less one; and the median of x less that of y, in the unit of the values.
EFFECTS = tuple(f"{name}{end}" for name in ("a12", "cliffs_delta", "difference") for end in ("", "_low", "_high"))


def mean_with_interval(x: ArrayLike) -> tuple[float, float, float]:
    """Return the mean of n >= 2 values, shape (n,), and the ends of Student's interval of 95 %, unrounded."""
    values = np.asarray(x, dtype=np.float64)
    mean, error = float(values.mean()), float(values.std(ddof=1)) / math.sqrt(len(values))
    half = float(student.ppf((1 + LEVEL) / 2, len(values) - 1)) * error
    return mean, mean - half, mean + half


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
    return _interval(float(np.median(ordered)), low, high)


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


def proportion(hits: int, of: int) -> Interval:
    """Return the part of so many trials, at least 1, that hit, with the exact interval (Clopper and Pearson 1934)."""
    ends = binomtest(hits, of).proportion_ci(LEVEL, method="exact")
    return _interval(hits / of, float(ends.low), float(ends.high))


def superiority(x: ArrayLike, y: ArrayLike, *, level: float = LEVEL) -> Interval:
    """Estimate P(x < y) + P(x = y) / 2, the chance that one seed of x is better than one of y.

    The interval is Newcombe's fifth (2006, Statistics in Medicine 25: 559-573): all chances that lie within z standard
    deviations of the estimate, by the variance of Hanley and McNeil (1982) with both sizes replaced by their mean. It
    has a width where samples do not overlap, and for one value of each, where a bootstrap has none.

    Args:
        x: shape (n,), n >= 1.
        y: shape (m,), m >= 1.
        level: of the interval, in (0, 1).
    """
    first, second = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    below = first[:, None] < second[None, :]
    estimate = float((below + 0.5 * (first[:, None] == second[None, :])).mean())
    pairs, more = len(first) * len(second), (len(first) + len(second)) / 2 - 1
    z = NormalDist().inv_cdf((1 + level) / 2)

    def outside(chance: float) -> float:
        spread = chance * (1 - chance) * (1 + more * ((1 - chance) / (2 - chance) + chance / (1 + chance))) / pairs
        return float((chance - estimate) ** 2 - z**2 * spread)

    # The estimate itself is a root where it is 0 or 1, and not the one that is looked for.
    low = 0.0 if estimate == 0 else float(brentq(outside, 0.0, estimate * (1 - 1e-9), xtol=1e-14))
    high = 1.0 if estimate == 1 else float(brentq(outside, estimate + (1 - estimate) * 1e-9, 1.0, xtol=1e-14))
    return _interval(estimate, low, high)


def effects_of_constant(value: float, y: ArrayLike) -> dict[str, float]:
    """Estimate how a value that knows no seeds, such as a trivial predictor's score, differs from a sample (`EFFECTS`).

    One sample, and nothing to resample: A12 is the part of y below the value, with Wilson's interval (1927), and the
    difference from y's median has the interval of that median (`median`).

    Args:
        value: finite.
        y: shape (m,), m >= 2.

    Raises:
        ValueError: the sample has another shape, or values that are not finite.
    """
    sample = checked(y, name="y")
    part, n = float((sample < value).mean() + (sample == value).mean() / 2), len(sample)
    z = NormalDist().inv_cdf((1 + LEVEL) / 2)
    centre = (part + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z * math.sqrt(part * (1 - part) / n + z**2 / (4 * n**2)) / (1 + z**2 / n)
    middle = median(sample)
    return _columns(
        _interval(part, max(0.0, centre - half), min(1.0, centre + half)),
        _interval(value - middle.estimate, value - middle.high, value - middle.low),
    )


def effects(x: ArrayLike, y: ArrayLike, *, rng: np.random.Generator, resamples: int = RESAMPLES) -> dict[str, float]:
    """Estimate all effects with their 95 % intervals (`EFFECTS`).

    For the difference of medians values are drawn again within each sample, n of x and m of y, as its seeds were drawn.
    Its interval's ends are resampled estimates themselves, so nothing is interpolated.

    Args:
        x: shape (n,), n >= 2.
        y: shape (m,), m >= 2.
        rng: gives the resamples; equal states give equal bits.
        resamples: at least 39, below which there is no 2.5 % on either side.

    Raises:
        ValueError: a sample has another shape or values that are not finite.
    """
    first, second = checked(x, name="x"), checked(y, name="y")
    from_first = rng.integers(len(first), size=(resamples, len(first)))
    from_second = rng.integers(len(second), size=(resamples, len(second)))
    differences = np.median(first[from_first], axis=1) - np.median(second[from_second], axis=1)
    difference = float(np.median(first) - np.median(second))
    return _columns(superiority(second, first), interval(difference, differences))


def _columns(a12: Interval, difference: Interval) -> dict[str, float]:
    delta = _interval(*(2 * end - 1 for end in (a12.estimate, a12.low, a12.high)))
    return a12.columns("a12") | delta.columns("cliffs_delta") | difference.columns("difference")


def interval(estimate: float, drawn: Sample) -> Interval:
    """Return an estimate with the percentile interval of its resamples: equally much is cut off both ends.

    Args:
        estimate: of the sample itself.
        drawn: of each resample, shape (n,), n >= 39.
    """
    ends = np.sort(drawn)
    cut = round((1 - LEVEL) / 2 * (len(drawn) + 1))
    return _interval(estimate, float(ends[cut - 1]), float(ends[-cut]))


def _interval(estimate: float, low: float, high: float) -> Interval:
    return Interval(rounded(estimate), rounded(low), rounded(high))
