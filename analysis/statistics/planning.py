"""The number of seeds that find a wished effect, by the tests that the finished study or sweep will use.

One value of a sample is drawn from a normal distribution, of logarithms for an error: its spread is a pilot's. One
sample of the family differs from the reference by the effect, the others do not; that leaves it Holm's strictest
steps. docs/statistics.md says what follows from these assumptions.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtri
from scipy.stats import rankdata

from analysis.statistics.samples import checked
from analysis.statistics.tests import p_values
from tacevo.randomness import stream
from tacevo.rounding import rounded

#: Simulated studies of each size; a chance of 0.8 is off by 0.018 at most, 19 times of 20.
TRIALS = 2_000

#: The most seeds that are looked at.
MOST = 200

#: With this confidence the true spread is below the upper limit (Browne 1995, Statistics in Medicine 14: 1933-1940).
CONFIDENCE = 0.8

#: Draws from which the deviation of a median is estimated.
_MEDIANS = 20_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """A standard deviation that was estimated from several samples."""

    deviation: float
    #: Degrees of freedom: values less samples.
    freedom: int

    @property
    def upper(self) -> float:
        """Its upper limit: the true one lies below with a chance of 80 %, if values are normal."""
        return rounded(self.deviation * math.sqrt(self.freedom / chdtri(self.freedom, CONFIDENCE)))

    @property
    def interval(self) -> tuple[float, float]:
        """Its 95 % interval, if values are normal."""
        squares = self.freedom * self.deviation**2
        low, high = (rounded(math.sqrt(squares / chdtri(self.freedom, tail))) for tail in (0.025, 0.975))
        return low, high


def pooled(samples: Sequence[ArrayLike]) -> Spread | None:
    """Estimate the deviation within samples, each of shape (n,) with n >= 2; None without such a sample.

    Raises:
        ValueError: a sample has another shape, or values that are not finite.
    """
    checked_samples = [checked(sample, name="a pilot's sample") for sample in samples]
    freedom = sum(len(sample) - 1 for sample in checked_samples)
    if not freedom:
        return None
    squares = sum(float(((sample - sample.mean()) ** 2).sum()) for sample in checked_samples)
    return Spread(deviation=rounded(math.sqrt(squares / freedom)), freedom=freedom)


@cache
def median_deviation(seeds: int) -> float:
    """Return the standard deviation of the median of so many values of a standard normal distribution, in (0, 1]."""
    draws = stream(0, "plan", "medians", seeds).standard_normal((_MEDIANS, seeds))
    return 1.0 if seeds == 1 else float(np.median(draws, axis=1).std())


def chance(seeds: int, *, shift: float, comparisons: int, alpha: float) -> float:
    """Return how often a shift is found after Holm's correction, in [0, 1].

    Args:
        seeds: of each sample, at least 2.
        shift: of one sample, in standard deviations of a value.
        comparisons: tests of the family, all against the same reference.
        alpha: their level.
    """
    values = stream(0, "plan", seeds, comparisons).standard_normal((comparisons + 1, TRIALS, seeds))
    values[1] += shift
    of_u = p_values(seeds, seeds)
    p = np.stack([of_u[_u(arm, values[0])] for arm in values[1:]], axis=1)
    order = np.argsort(p, axis=1, kind="stable")
    passed = np.take_along_axis(p, order, axis=1) <= alpha / np.arange(comparisons, 0, -1)
    significant = np.logical_and.accumulate(passed, axis=1)
    return float(significant[order == 0].mean())


def needed(*, shift: float, comparisons: int, alpha: float, power: float) -> tuple[int | None, float]:
    """Return the fewest seeds whose chance of finding a shift reaches the wished power, and that chance.

    It is None, with the chance of `MOST`, where even these do not; arguments are as of `chance`.
    """
    low, high = 1, 2  # more than `low` are needed
    while (reached := chance(high, shift=shift, comparisons=comparisons, alpha=alpha)) < power:
        if high == MOST:
            return None, reached
        low, high = high, min(2 * high, MOST)
    while high - low > 1:
        middle = (low + high) // 2
        between = chance(middle, shift=shift, comparisons=comparisons, alpha=alpha)
        if between < power:
            low = middle
        else:
            high, reached = middle, between
    return high, reached


def _u(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.int64]:
    """Count the pairs first > second in each row of two arrays of shape (trials, seeds), without ties."""
    seeds = first.shape[1]
    ranks = rankdata(np.concatenate([first, second], axis=1), method="ordinal", axis=1)
    counted: NDArray[np.int64] = ranks[:, :seeds].sum(axis=1) - seeds * (seeds + 1) // 2
    return counted
