"""Promise: samples are called equivalent only where a shift as large as the margin is ruled out on both sides."""

import numpy as np
import pytest
from scipy.stats import mannwhitneyu
from statsmodels.stats.weightstats import ttost_ind

from analysis.statistics.tests import Method, equivalence
from tacevo.rounding import rounded


def test_both_sides_are_scipys_tests_of_shifted_samples() -> None:
    """Raised by the margin, x must lie above y; lowered by it, below."""
    draw = np.random.default_rng(1)
    x, y = draw.normal(size=20), draw.normal(size=20)
    below = mannwhitneyu(x + 0.5, y, alternative="greater", method="exact").pvalue
    above = mannwhitneyu(x - 0.5, y, alternative="less", method="exact").pvalue
    for one, other in ((x, y), (y, x)):
        p, method = equivalence(one, other, margin=0.5)
        assert p == pytest.approx(max(below, above))
        assert method is Method.exact


def test_conclusion_is_that_of_welchs_tests_on_normal_samples() -> None:
    """Statsmodels has the parametric form only; on normal samples both come to about the same p."""
    draw = np.random.default_rng(2)
    x, y = draw.normal(size=30), draw.normal(size=30)
    for margin in (0.3, 0.6, 0.9):
        library = ttost_ind(x, y, -margin, margin, usevar="unequal")[0]
        assert equivalence(x, y, margin=margin)[0] == pytest.approx(library, abs=0.05)


def test_a_large_p_of_difference_is_no_equivalence() -> None:
    """Few, wide samples show no difference, and no equality either."""
    x, y = [1.0, 5.0, 9.0, 13.0], [2.0, 4.0, 10.0, 12.0]
    assert mannwhitneyu(x, y).pvalue > 0.8
    assert equivalence(x, y, margin=1)[0] > 0.2


def test_shift_of_the_margin_is_called_equivalent_no_oftener_than_alpha() -> None:
    """On the border, where the error is most likely, 400 pairs of samples."""
    draw = np.random.default_rng(3)
    wrong = sum(equivalence(draw.normal(1.5, size=20), draw.normal(size=20), margin=1.5)[0] <= 0.05 for _ in range(400))
    assert wrong / 400 <= 0.08


def test_shifted_values_tie_where_they_should() -> None:
    """0.1 + 0.2 is not 0.3 in binary; the comparison must not hang on that."""
    assert equivalence([0.1, 0.1], [0.3, 0.3], margin=0.2) == (1, Method.exact_ties)


@pytest.mark.parametrize(("images", "margin", "step"), [(300, 0.01, 3), (300, 0.05, 15), (700, 0.01, 7), (60, 0.05, 3)])
def test_shifted_accuracies_tie_wherever_they_should(images: int, margin: float, step: int) -> None:
    """Of every count of right images, each as a study records it; 28 of 300 and a point tie with 31."""
    shares = [rounded(right / images) for right in range(images + 1)]
    for low, high in zip(shares, shares[step:], strict=False):
        assert equivalence([low, low], [high, high], margin=margin)[0] == 1
        assert equivalence([high, high], [low, low], margin=margin)[0] == 1


@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1e6])
def test_small_and_large_values_are_compared_as_well(scale: float) -> None:
    """Digits are counted from the largest value, so a tiny error does not drown in them."""
    draw = np.random.default_rng(4)
    x, y = draw.normal(1, 0.1, size=10), draw.normal(1, 0.1, size=10)
    assert equivalence(scale * x, scale * y, margin=scale * 0.1) == equivalence(x, y, margin=0.1)


def test_test_without_a_margin_is_refused() -> None:
    """With a margin of 0 nothing can ever be equivalent."""
    with pytest.raises(ValueError, match=r"margin must be above 0; got 0"):
        equivalence([1, 2], [1, 2], margin=0)
