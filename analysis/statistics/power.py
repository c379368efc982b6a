"""What a study of so many seeds can see at all: the smallest effect it detects, by Noether's formula (1987)."""

import math
from dataclasses import dataclass
from statistics import NormalDist

from tacevo.rounding import rounded


@dataclass(frozen=True, slots=True, kw_only=True)
class Detectable:
    """The smallest effect that is found with the stated power."""

    #: Level of the two-sided test.
    alpha: float
    #: The chance of finding it.
    power: float
    #: P(x > y), in (0.5, 1); its mirror image below 0.5 is found as often.
    a12: float
    #: The shift of a normal distribution that makes this A12, in standard deviations.
    shift: float


def detectable(seeds: int, others: int | None = None, *, alpha: float, power: float = 0.8) -> Detectable | None:
    """Return the smallest effect that a two-sided Mann-Whitney test detects.

    Noether approximates the deviation of U by the one it has without any effect. Of a shifted normal distribution a
    large effect makes U vary less, so the true power is somewhat higher than stated; under unequal spreads U may vary
    more, and the power be lower.

    Args:
        seeds: in the first sample, at least 2.
        others: in the second sample, at least 2; None for as many.
        alpha: level of the test, in (0, 1); divided by the number of variants for Holm's first step, the strictest.
        power: wanted chance of detection, in (0, 1).

    Returns:
        None where the formula gives no effect: it needs an A12 of 1 or more for so few seeds. Effects near full
        separation may be detected all the same, unless no outcome of so few seeds is significant
        (`analysis.statistics.tests.smallest_p`).

    Raises:
        ValueError: an argument is out of its range.
    """
    second = seeds if others is None else others
    if min(seeds, second) < 2 or not 0 < alpha < 1 or not 0 < power < 1:
        raise ValueError(f"power needs seeds >= 2, alpha and power in (0, 1); got {seeds}, {second}, {alpha}, {power}")
    quantile = NormalDist().inv_cdf
    # N = (sum of both quantiles)² / (12 c (1 - c) (A12 - 1/2)²), with N of both samples and c the part of the first.
    effect = 0.5 + (quantile(1 - alpha / 2) + quantile(power)) / math.sqrt(12 * seeds * second / (seeds + second))
    if effect >= 1:
        return None
    shift = math.sqrt(2) * quantile(effect)
    return Detectable(alpha=rounded(alpha), power=power, a12=rounded(effect), shift=rounded(shift))
