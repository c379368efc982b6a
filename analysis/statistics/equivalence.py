"""Is there no difference that matters: two one-sided tests (Schuirmann 1987) against a margin stated beforehand.

A large p of a test for a difference is not evidence of equality. Here the burden of proof is reversed: a shift as large
as the margin, in either direction, has to be rejected. Each side is a Mann-Whitney test, as the comparison itself
is, so outliers among the seeds do not decide, and no normality is assumed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analysis.statistics.samples import Sample, checked
from analysis.statistics.tests import Method, mann_whitney
from tacevo.rounding import DIGITS


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
    decimals = _decimals(np.concatenate([first, second]))
    raised, lowered, still = (np.round(sample, decimals) for sample in (first + margin, first - margin, second))
    below = mann_whitney(raised, still, alternative="greater")
    above = mann_whitney(lowered, still, alternative="less")
    method = max(below.method, above.method, key=list(Method).index)
    return Equivalence(margin=margin, p_below=below.p, p_above=above.p, method=method)


def _decimals(values: Sample) -> int:
    """Count the decimals that leave the largest value its digits.

    A shifted value that should tie with another one misses it in the digits that either lost when it was rounded, and
    these begin with the last of the largest: 31/300 less 0.01 ties with 28/300 after nine decimals only.
    """
    return DIGITS - 1 - int(f"{np.abs(values).max():e}".partition("e")[2])
