"""Promise: samples are called equivalent only where a shift as large as the margin is ruled out on both sides."""

import math

import numpy as np
import pytest
from scipy.stats import mannwhitneyu
from statsmodels.stats.weightstats import ttost_ind

from analysis.equivalence import Margin, MarginKind, equivalence
from analysis.statistics import Method


def test_both_sides_are_scipys_tests_of_shifted_samples() -> None:
    """Raised by the margin, x must lie above y; lowered by it, below."""
    draw = np.random.default_rng(1)
    x, y = draw.normal(size=20), draw.normal(size=20)
    found = equivalence(x, y, margin=0.5)
    assert found.p_below == pytest.approx(mannwhitneyu(x + 0.5, y, alternative="greater", method="exact").pvalue)
    assert found.p_above == pytest.approx(mannwhitneyu(x - 0.5, y, alternative="less", method="exact").pvalue)
    assert found.p == max(found.p_below, found.p_above)


def test_three_against_three_by_hand() -> None:
    """A margin that separates both ways leaves one order of 20 on either side."""
    found = equivalence([1, 2, 3], [1.5, 2.5, 3.5], margin=10)
    assert (found.p_below, found.p_above, found.p) == (0.05, 0.05, 0.05)


def test_conclusion_is_that_of_welchs_tests_on_normal_samples() -> None:
    """Statsmodels has the parametric form only; on normal samples both come to about the same p."""
    draw = np.random.default_rng(2)
    x, y = draw.normal(size=30), draw.normal(size=30)
    for margin in (0.3, 0.6, 0.9):
        library = ttost_ind(x, y, -margin, margin, usevar="unequal")[0]
        assert equivalence(x, y, margin=margin).p == pytest.approx(library, abs=0.05)


def test_a_large_p_of_difference_is_no_equivalence() -> None:
    """Few, wide samples show no difference, and no equality either."""
    x, y = [1.0, 5.0, 9.0, 13.0], [2.0, 4.0, 10.0, 12.0]
    assert mannwhitneyu(x, y).pvalue > 0.8
    assert equivalence(x, y, margin=1).p > 0.2


def test_shift_of_the_margin_is_called_equivalent_no_oftener_than_alpha() -> None:
    """On the border, where the error is most likely, 400 pairs of samples."""
    draw = np.random.default_rng(3)
    wrong = sum(equivalence(draw.normal(1.5, size=20), draw.normal(size=20), margin=1.5).p <= 0.05 for _ in range(400))
    assert wrong / 400 <= 0.08


def test_shifted_values_tie_where_they_should() -> None:
    """0.1 + 0.2 is not 0.3 in binary; the comparison must not hang on that."""
    found = equivalence([0.1, 0.1], [0.3, 0.3], margin=0.2)
    assert found.p_below == 1
    assert found.method is Method.exact_ties


@pytest.mark.parametrize(
    ("margin", "width"),
    [
        (Margin(value=0.1, kind=MarginKind.relative), 0.0006),
        (Margin(value=0.1, kind=MarginKind.absolute), 0.1),
    ],
)
def test_margin_is_part_of_the_median_or_of_the_metric(margin: Margin, width: float) -> None:
    """Around the paper's median MSE of 0.006."""
    assert margin.around(0.006) == width


def test_relative_margin_has_no_sign() -> None:
    """A metric below zero has a margin too."""
    assert Margin(value=0.5, kind=MarginKind.relative).around(-2) == 1


@pytest.mark.parametrize("value", [0.0, -0.1, math.nan, math.inf])
def test_margin_that_nothing_fits_in_is_refused(value: float) -> None:
    """Nor one that everything fits in."""
    with pytest.raises(ValueError, match="an equivalence margin must be above 0"):
        Margin(value=value, kind=MarginKind.absolute)


def test_test_without_a_margin_is_refused() -> None:
    """With a margin of 0 nothing can ever be equivalent."""
    with pytest.raises(ValueError, match=r"margin must be above 0; got 0"):
        equivalence([1, 2], [1, 2], margin=0)
