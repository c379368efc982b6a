"""Is there a difference: the tests of Mann and Whitney (1947) and of a hypergeometric count, Holm's (1979) correction.

Pure functions; docs/statistics.md says why these. The distribution of U is exact where it can be counted, with
ties too; the result says how its p came about. Tests compare what is counted here with SciPy; Holm's correction is
that of statsmodels.

Is there no difference that matters: two one-sided tests (Schuirmann 1987) against a margin stated beforehand. A large p
of a test for a difference is not evidence of equality, so there the burden of proof is reversed: a shift as large as
the margin, in either direction, has to be rejected. Each side is a Mann-Whitney test, as the comparison itself is, so
outliers among the seeds do not decide, and no normality is assumed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from statistics import NormalDist
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr
from scipy.stats import binomtest, hypergeom
from statsmodels.stats.multitest import multipletests

from analysis.statistics.samples import Sample, checked
from tacevo.rounding import DIGITS, rounded

#: The alternative of a test: values of the first sample differ from, or lie above or below, the second's.
Alternative = Literal["two-sided", "greater", "less"]


class Method(StrEnum):
    """The way in which a p was computed; the values are the words of a table."""

    #: Every arrangement of the ranks, counted.
    exact = "exact"
    #: Every arrangement of the midranks, counted.
    exact_ties = "exact, ties"
    #: Too many arrangements to count: normal, with corrections for ties and continuity.
    normal = "normal"


@dataclass(frozen=True, slots=True, kw_only=True)
class MannWhitney:
    """The result of the test."""

    #: Pairs (x, y) with x > y, where x = y counts a half; in [0, n m].
    u: float
    #: The p-value, in (0, 1].
    p: float
    method: Method


def mann_whitney(x: ArrayLike, y: ArrayLike, *, alternative: Alternative = "two-sided") -> MannWhitney:
    """Test whether values of two samples tend to differ.

    Without further assumptions this is a test of stochastic dominance, P(x > y) + P(x = y) / 2 = 1/2, and of equal
    medians only where the two distributions differ by nothing but a shift.

    Args:
        x: shape (n,), n >= 2.
        y: shape (m,), m >= 2.
        alternative: as seen from x.

    Raises:
        ValueError: a sample has another shape, or values that are not finite.
    """
    return blocked_mann_whitney([(x, y)], alternative=alternative)


def blocked_mann_whitney(
    blocks: Sequence[tuple[ArrayLike, ArrayLike]], *, alternative: Alternative = "two-sided"
) -> MannWhitney:
    """Test whether values of two samples tend to differ within blocks, by the sum of U over the blocks.

    This is van Elteren's test (1960) with equal weights, which are his where blocks are of one size. Values are ranked
    within their block, so blocks may differ in level and spread.

    Args:
        blocks: at least one, each of two samples as of `mann_whitney`.
        alternative: as seen from the first samples.

    Raises:
        ValueError: a sample has another shape, or values that are not finite.
    """
    pairs = [(checked(x, name="x"), checked(y, name="y")) for x, y in blocks]
    ranked = [_doubled_ranks(x, y) for x, y in pairs]
    u = sum(_u(doubled, len(x)) for (doubled, _), (x, _) in zip(ranked, pairs, strict=True))
    if max(math.comb(len(doubled), len(doubled) // 2) for doubled, _ in ranked) >= 2**63:  # counts are 64-bit integers
        method, middle = Method.normal, sum(len(x) * len(y) / 2 for x, y in pairs)
        # Of a choice of n from N ranks without replacement; ranks are halves of these.
        variance = sum(
            len(x) * len(y) / (len(x) + len(y) - 1) * float(np.var(doubled / 2))
            for (doubled, _), (x, y) in zip(ranked, pairs, strict=True)
        )
        # Half a pair nearer to the middle, for continuity.
        below, above = (
            float(ndtr((side * (u - middle) + 0.5) / math.sqrt(variance))) if variance else 1.0 for side in (1, -1)
        )
    else:
        chances, here = np.ones(1), 0
        for (doubled, _), (x, _) in zip(ranked, pairs, strict=True):
            counts = _sums_of(doubled, len(x))
            chances = np.convolve(chances, counts / counts.sum())
            here += int(doubled[: len(x)].sum())
        below, above = float(chances[: here + 1].sum()), float(chances[here:].sum())
        method = Method.exact_ties if any(tied for _, tied in ranked) else Method.exact
    p = {"less": below, "greater": above, "two-sided": 2 * min(below, above)}[alternative]
    return MannWhitney(u=u, p=rounded(min(1.0, p)), method=method)


def sign_p(better: int, worse: int) -> float:
    """Return the two-sided p of the exact sign test: cases that go either way as often, equal ones left out.

    Returns:
        In (0, 1]; 1 without a case.
    """
    return rounded(float(binomtest(better, better + worse).pvalue)) if better + worse else 1.0


def holm(p_values: Sequence[float]) -> tuple[float, ...]:
    """Correct a family of p-values for their number, after Holm (1979).

    The k-th smallest of m is multiplied by m - k + 1, and is at least as large as every smaller one's result.

    Returns:
        In the given order, each in [0, 1].

    Raises:
        ValueError: the list is empty, or a p-value is not in [0, 1].
    """
    if not p_values or not all(0 <= p <= 1 for p in p_values):
        raise ValueError(f"Holm's correction needs one or more p-values in [0, 1]; got {list(p_values)}")
    if len(p_values) == 1:
        return (rounded(p_values[0]),)  # statsmodels collects garbage at each call, which takes its time
    _, corrected, _, _ = multipletests(p_values, method="holm")
    return tuple(rounded(float(p)) for p in corrected)


def hypergeometric_p(hits: int, *, drawn: int, marked: int, population: int) -> float:
    """Return the chance that a draw without replacement holds at least as many marked ones as were found.

    This is Fisher's exact test, one-sided.

    Args:
        hits: marked ones in the draw, in [0, min(drawn, marked)].
        drawn: size of the draw, in [0, population].
        marked: marked ones in the population, in [0, population].
        population: its size.

    Returns:
        In (0, 1].
    """
    return rounded(float(hypergeom.sf(hits - 1, population, marked, drawn)))


def smallest_p(n: int, m: int) -> float:
    """Return the smallest two-sided p that samples of n and m values can reach: the two extreme orders of all."""
    return rounded(2 / math.comb(n + m, n))


def p_values(n: int, m: int) -> NDArray[np.float64]:
    """Return the two-sided p of every U that samples of n and m values without ties can have, shape (n m + 1,).

    They are those of `mann_whitney`, for whoever needs thousands of them.
    """
    if math.comb(n + m, (n + m) // 2) >= 2**63:
        distance = np.abs(np.arange(n * m + 1) - n * m / 2) - 0.5  # with the correction for continuity
        tail = ndtr(-distance / math.sqrt(n * m * (n + m + 1) / 12))
    else:
        counts = _sums_of(np.arange(1, n + m + 1), n)[n * (n + 1) // 2 :][: n * m + 1]
        below = np.cumsum(counts) / counts.sum()
        tail = np.minimum(below, below[::-1])
    p: NDArray[np.float64] = np.minimum(1.0, 2 * tail)
    return p


def _doubled_ranks(x: Sample, y: Sample) -> tuple[NDArray[np.int64], bool]:
    """Return twice the midranks of both samples together, which are whole, and whether values tie."""
    _, ranks, counts = np.unique(np.concatenate([x, y]), return_inverse=True, return_counts=True)
    return (2 * np.cumsum(counts) - counts + 1)[ranks], bool(counts.max() > 1)


def _u(doubled: NDArray[np.int64], n: int) -> float:
    return int(doubled[:n].sum()) / 2 - n * (n + 1) / 2


def _sums_of(doubled: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    """Count, for every sum, the choices of n of the doubled ranks that add up to it (Streitberg & Röhmel 1986)."""
    counts = np.zeros((n + 1, int(doubled.sum()) + 1), dtype=np.int64)
    counts[0, 0] = 1
    for rank in doubled:
        counts[1:, rank:] = counts[1:, rank:] + counts[:-1, :-rank]  # without it, and with it
    chosen: NDArray[np.int64] = counts[n]
    return chosen


def equivalence(x: ArrayLike, y: ArrayLike, *, margin: float) -> tuple[float, Method]:
    """Test whether x is shifted against y by less than a margin.

    Args:
        x: shape (n,), n >= 2.
        y: shape (m,), m >= 2.
        margin: above 0, in the unit of the values.

    Returns:
        The larger p of both hypotheses, that x lies below y by the margin or more and that it lies above, since both
        must fall; and how the p came about, the weaker of the two.

    Raises:
        ValueError: a sample has another shape or values that are not finite, or the margin is not above 0.
    """
    first, second = checked(x, name="x"), checked(y, name="y")
    if not margin > 0:
        raise ValueError(f"an equivalence margin must be above 0; got {margin}")
    decimals = _decimals(np.concatenate([first, second]))
    raised, lowered, still = (np.round(sample, decimals) for sample in (first + margin, first - margin, second))
    below = mann_whitney(raised, still, alternative="greater")
    above = mann_whitney(lowered, still, alternative="less")
    return max(below.p, above.p), max(below.method, above.method, key=list(Method).index)


def _decimals(values: Sample) -> int:
    """Count the decimals that leave the largest value its digits.

    A shifted value that should tie with another one misses it in the digits that either lost when it was rounded, and
    these begin with the last of the largest: 31/300 less 0.01 ties with 28/300 after nine decimals only.
    """
    return DIGITS - 1 - int(f"{np.abs(values).max():e}".partition("e")[2])


#: The power with which a test finds the smallest effect that it detects.
POWER = 0.8


def detectable(n: int, m: int, *, alpha: float) -> tuple[float, float] | None:
    """Return the smallest effect that a two-sided Mann-Whitney test of n and m values finds with a power of 80 %.

    Noether (1987) approximates the deviation of U by the one it has without any effect. Of a shifted normal
    distribution a large effect makes U vary less, so the true power is somewhat higher than stated; under unequal
    spreads U may vary more, and the power be lower.

    Args:
        n: values of the first sample, at least 2.
        m: values of the second, at least 2.
        alpha: level of the test, in (0, 1); divided by the number of variants for Holm's first step, the strictest.

    Returns:
        The A12, in (0.5, 1), whose mirror image is found as often; and the shift of a normal distribution that makes
        it, in standard deviations. None where the formula gives no effect: it needs an A12 of 1 or more for so
        few seeds. Effects near full separation may be detected all the same, unless no outcome of so few is significant
        (`smallest_p`).
    """
    quantile = NormalDist().inv_cdf
    # N = (sum of both quantiles)² / (12 c (1 - c) (A12 - 1/2)²), with N of both samples and c the part of the first.
    effect = 0.5 + (quantile(1 - alpha / 2) + quantile(POWER)) / math.sqrt(12 * n * m / (n + m))
    return None if effect >= 1 else (rounded(effect), rounded(math.sqrt(2) * quantile(effect)))
