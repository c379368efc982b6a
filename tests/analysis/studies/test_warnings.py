"""Promise: every assumption that a pair of samples fails is named, and none that it meets."""

import numpy as np
import pytest
from numpy.typing import ArrayLike

from analysis.statistics.tests import holm, mann_whitney, smallest_p
from analysis.studies.warnings import Caution, cautions

PLAIN = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])


def told(x: ArrayLike, y: ArrayLike, least_p: float = 0.01) -> tuple[Caution, ...]:
    """Test two samples, and list the cautions."""
    return cautions(x, y, method=mann_whitney(x, y).method, least_p=least_p, alpha=0.05)


def test_plain_samples_need_no_caution() -> None:
    """Distinct, overlapping, equally wide, and enough of them."""
    assert told(PLAIN, PLAIN + 0.5) == ()


@pytest.mark.parametrize(
    ("x", "y", "expected"),
    [
        ([3.2] * 6, PLAIN, {Caution.equal_values, Caution.ties, Caution.spreads}),
        ([1.0, 2.1, 3.1, 4.1, 5.1, 6.1], PLAIN, {Caution.ties}),
        (PLAIN * 2.1 - 4.05, PLAIN, {Caution.spreads}),
        (PLAIN * 1.9 - 3.45, PLAIN, set()),
        (PLAIN + 10, PLAIN, set()),
    ],
)
def test_each_failed_assumption_is_named(x: list[float], y: list[float], expected: set[Caution]) -> None:
    """Identical values, ties, spreads on either side of a factor 2; samples apart need no caution."""
    assert set(told(x, y)) == expected


def test_seeds_too_few_for_any_result_are_named() -> None:
    """Of 4 and 4 the smallest p is 2 / 70 = 0.029: enough by itself, not for the strictest of two."""
    x, y = [1, 3, 5, 7], [2, 4, 6, 8]
    assert told(x, y, smallest_p(4, 4)) == ()
    assert told(x, y, holm([smallest_p(4, 4)] * 2)[0]) == (Caution.few_seeds,)


def test_an_approximated_p_is_named() -> None:
    """From 67 values on together."""
    draw = np.random.default_rng(0)
    assert told(draw.normal(size=40), draw.normal(size=40)) == (Caution.approximate,)
