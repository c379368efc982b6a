"""The smallest effect that a test of so many values can see."""

import math
from statistics import NormalDist

from tacevo.rounding import rounded

#: Of the smallest effect that a test detects.
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
        (`analysis.statistics.tests.smallest_p`).
    """
    quantile = NormalDist().inv_cdf
    # N = (sum of both quantiles)² / (12 c (1 - c) (A12 - 1/2)²), with N of both samples and c the part of the first.
    effect = 0.5 + (quantile(1 - alpha / 2) + quantile(POWER)) / math.sqrt(12 * n * m / (n + m))
    return None if effect >= 1 else (rounded(effect), rounded(math.sqrt(2) * quantile(effect)))
