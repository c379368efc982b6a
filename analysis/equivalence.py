"""Is there no difference that matters: two one-sided tests (Schuirmann 1987) against a margin stated beforehand.

A large p of a test for a difference is no evidence of equality. Here the burden is turned round: a shift as large
as the margin, in either direction, has to be rejected. Each side is a Mann-Whitney test, as the comparison itself
is, so outliers among the seeds do not decide, and no normality is assumed.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from analysis.samples import Sample, checked, rounded
from analysis.statistics import Method, mann_whitney


class MarginKind(StrEnum):
    """What a margin counts in."""

    #: Parts of the baseline's median.
    relative = "relative"
    #: The unit of the metric.
    absolute = "absolute"


@dataclass(frozen=True, slots=True, kw_only=True)
class Margin:
    """The largest shift that is called no difference; to be chosen before the study is seen."""

    #: Above 0; 0.1 is 10 % of the baseline's median, or 0.1 of the metric.
    value: float
    kind: MarginKind

    def __post_init__(self) -> None:
        """Refuse a margin that nothing fits in."""
        if not (np.isfinite(self.value) and self.value > 0):
            raise ValueError(f"an equivalence margin must be above 0; got {self.value}")

    def around(self, median: float) -> float:
        """Give the margin in the unit of the metric, around a baseline's median."""
        return rounded(self.value * abs(median)) if self.kind is MarginKind.relative else self.value


@dataclass(frozen=True, slots=True, kw_only=True)
class Equivalence:
    """What the two tests found."""

    #: In the unit of the values.
    margin: float
    #: Of the hypothesis that x lies below y by the margin or more.
    p_below: float
    #: Of the hypothesis that x lies above y by the margin or more.
    p_above: float
    #: How the p came about, the weaker of the two.
    method: Method

    @property
    def p(self) -> float:
        """Both hypotheses must fall, so the larger p is that of equivalence."""
        return max(self.p_below, self.p_above)


def equivalence(x: ArrayLike, y: ArrayLike, *, margin: float) -> Equivalence:
    """Test whether x is shifted against y by less than a margin.

    Args:
        x: shape (n,), n >= 2.
        y: shape (m,), m >= 2.
        margin: above 0, in the unit of the values.

    Raises:
        ValueError: a sample has another shape or values that are not finite, or the margin is not above 0.
    """
    first, second = checked(x, name="x"), checked(y, name="y")
    if not margin > 0:
        raise ValueError(f"an equivalence margin must be above 0; got {margin}")
    below = mann_whitney(_shifted(first, margin), _shifted(second, 0), alternative="greater")
    above = mann_whitney(_shifted(first, -margin), _shifted(second, 0), alternative="less")
    method = max(below.method, above.method, key=list(Method).index)
    return Equivalence(margin=margin, p_below=below.p, p_above=above.p, method=method)


def _shifted(sample: Sample, shift: float) -> Sample:
    """Move a sample, and drop the digits in which a sum that should tie with another value would miss it."""
    return np.array([rounded(value) for value in sample + shift])
