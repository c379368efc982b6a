"""Promise: effect sizes are those of their definitions, and intervals hang on the passed generator alone."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import bootstrap, mannwhitneyu

from analysis.effects import a12, cliffs_delta, effects, median, median_difference

VALUES = st.lists(st.integers(-3, 3).map(float), min_size=2, max_size=8)


def test_effects_by_hand() -> None:
    """Of the six pairs of (1, 3, 3) with (2, 3), two lie above, two tie and two lie below; medians 3 and 2.5."""
    x, y = [1.0, 3.0, 3.0], [2.0, 3.0]
    assert (a12(x, y), cliffs_delta(x, y), median_difference(x, y)) == (0.5, 0.0, 0.5)


def test_published_example_of_a12() -> None:
    """More pairs above than below: (2, 3) against (1, 2) has 3 of 4 above and one tie, 3.5 / 4."""
    assert (a12([2, 3], [1, 2]), cliffs_delta([2, 3], [1, 2])) == (0.875, 0.75)


@given(VALUES, VALUES)
def test_a12_is_scipys_u_over_all_pairs(x: list[float], y: list[float]) -> None:
    """And Cliff's delta is twice that less one."""
    u = mannwhitneyu(x, y, method="exact").statistic
    assert a12(x, y) == pytest.approx(u / (len(x) * len(y)))
    assert cliffs_delta(x, y) == pytest.approx(2 * a12(x, y) - 1)


@given(VALUES, VALUES)
def test_exchanging_the_samples_mirrors_the_effects(x: list[float], y: list[float]) -> None:
    """What lies above from here lies below from there."""
    assert a12(x, y) + a12(y, x) == pytest.approx(1)
    assert median_difference(x, y) == -median_difference(y, x)


@given(VALUES, VALUES, st.integers(0, 9))
def test_intervals_are_ordered_and_in_range(x: list[float], y: list[float], seed: int) -> None:
    """Low is never above high, and no interval leaves the range of its effect."""
    found = effects(x, y, rng=np.random.default_rng(seed), resamples=99)
    assert 0 <= found.a12.low <= found.a12.high <= 1
    assert -1 <= found.cliffs_delta.low <= found.cliffs_delta.high <= 1
    assert found.median_difference.low <= found.median_difference.high
    assert found.cliffs_delta.low == pytest.approx(2 * found.a12.low - 1)


def test_equal_generators_give_equal_bits_whatever_the_global_state() -> None:
    """The test that would have caught an estimator which ignores its generator."""
    x, y = np.random.default_rng(3).normal(size=(2, 20))
    np.random.seed(1)  # noqa: NPY002 - the global state is what must not matter
    one = effects(x, y, rng=np.random.default_rng(7))
    np.random.seed(2)  # noqa: NPY002
    assert effects(x, y, rng=np.random.default_rng(7)) == one
    assert effects(x, y, rng=np.random.default_rng(8)) != one


def test_intervals_are_near_scipys_percentile_bootstrap() -> None:
    """Same method, other resamples: the ends differ by their own noise."""
    x, y = np.random.default_rng(4).normal(size=20), np.random.default_rng(5).normal(0.7, size=20)
    found = effects(x, y, rng=np.random.default_rng(0))
    for measure, interval in ((cliffs_delta, found.cliffs_delta), (median_difference, found.median_difference)):
        library = bootstrap(
            (x, y), measure, vectorized=False, n_resamples=2_000, method="percentile", rng=np.random.default_rng(1)
        ).confidence_interval
        assert (interval.low, interval.high) == pytest.approx((library.low, library.high), abs=0.08)


def test_intervals_cover_the_truth_about_as_often_as_they_say() -> None:
    """Of 200 pairs of normal samples, the true A12 of 0.714 lies in the interval of 0.9 to 0.99 of them."""
    draw = np.random.default_rng(6)
    held = 0
    for _ in range(200):
        interval = effects(draw.normal(0.8, size=20), draw.normal(size=20), rng=draw, resamples=399).a12
        held += interval.low <= 0.7142 <= interval.high
    assert 0.9 <= held / 200 <= 0.99


def test_separated_samples_have_an_interval_without_width() -> None:
    """No resample can show an overlap that the samples lack; a caution says so elsewhere."""
    found = effects([4, 5, 6], [1, 2, 3], rng=np.random.default_rng(0)).a12
    assert (found.estimate, found.low, found.high) == (1, 1, 1)


def test_too_few_resamples_are_refused() -> None:
    """Below 39 the 2.5 % ends do not exist."""
    with pytest.raises(ValueError, match="needs resamples >= 39; got 38"):
        effects([1, 2], [3, 4], rng=np.random.default_rng(0), resamples=38)


def test_values_that_are_not_finite_name_their_seeds() -> None:
    """Every effect refuses them, the intervals too."""
    for effect in (a12, cliffs_delta, median_difference):
        with pytest.raises(ValueError, match=r"x is not finite for seeds \[1\]"):
            effect([1, np.nan, 3], [1, 2, 3])
    with pytest.raises(ValueError, match=r"y is not finite for seeds \[0\]"):
        effects([1, 2], [np.inf, 3], rng=np.random.default_rng(0))


def test_median_of_five_has_their_range_as_interval() -> None:
    """Three draws or more of five are the least value with a chance of 5.8 %, which is more than 2.5 %."""
    found = median([5, 1, 4, 2, 3], rng=np.random.default_rng(0))
    assert (found.estimate, found.low, found.high) == (3, 1, 5)


def test_median_has_an_interval_near_scipys() -> None:
    """Same method, other resamples: of 40 values, the ends differ by a few ranks at most."""
    x = np.random.default_rng(2).normal(size=40)
    ours = median(x, rng=np.random.default_rng(0))
    theirs = bootstrap((x,), np.median, n_resamples=9_999, method="percentile", rng=np.random.default_rng(1))
    ends = theirs.confidence_interval
    assert (ours.low, ours.high) == pytest.approx((ends.low, ends.high), abs=0.05)


def test_median_needs_seeds_and_resamples() -> None:
    """One value is no sample, and too few resamples have no ends."""
    with pytest.raises(ValueError, match=r"must have shape \(n,\) with n >= 2 seeds"):
        median([1.0], rng=np.random.default_rng(0))
    with pytest.raises(ValueError, match="needs resamples >= 39; got 38"):
        median([1.0, 2.0], rng=np.random.default_rng(0), resamples=38)
