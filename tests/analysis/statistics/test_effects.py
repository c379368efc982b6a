"""Promise: effect sizes are those of their definitions, and intervals hang on the passed generator alone."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import bootstrap, mannwhitneyu, norm

from analysis.statistics.effects import (
    effects,
    median,
    median_confidence,
    superiority,
)

VALUES = st.lists(st.integers(-3, 3).map(float), min_size=2, max_size=8)

#: One value is enough for a chance.
SAMPLES = st.lists(st.integers(-3, 3).map(float), min_size=1, max_size=8)


def test_effects_by_hand() -> None:
    """Of the six pairs of (1, 3, 3) with (2, 3), two lie above, two tie and two lie below; medians 3 and 2.5."""
    x, y = [1.0, 3.0, 3.0], [2.0, 3.0]
    measures = effects(x, y, rng=np.random.default_rng(0), resamples=39)
    assert (measures["a12"], measures["cliffs_delta"], measures["difference"]) == (0.5, 0.0, 0.5)


@given(VALUES, VALUES)
def test_a12_is_scipys_u_over_all_pairs(x: list[float], y: list[float]) -> None:
    """That is the chance that a value of the second sample is lower."""
    u = mannwhitneyu(x, y, method="exact").statistic
    assert superiority(y, x).estimate == pytest.approx(u / (len(x) * len(y)))


@given(VALUES, VALUES, st.integers(0, 9))
def test_intervals_are_ordered_and_in_range(x: list[float], y: list[float], seed: int) -> None:
    """Low is never above high, and no interval leaves the range of its effect."""
    measures = effects(x, y, rng=np.random.default_rng(seed), resamples=99)
    assert 0 <= measures["a12_low"] <= measures["a12_high"] <= 1
    assert measures["difference_low"] <= measures["difference_high"]
    assert measures["cliffs_delta_low"] == pytest.approx(2 * measures["a12_low"] - 1)


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
    measures = effects(x, y, rng=np.random.default_rng(0))
    library = bootstrap(
        (x, y),
        lambda one, other: np.median(one) - np.median(other),
        vectorized=False,
        n_resamples=2_000,
        method="percentile",
        rng=np.random.default_rng(1),
    ).confidence_interval
    assert (measures["difference_low"], measures["difference_high"]) == pytest.approx(
        (library.low, library.high), abs=0.08
    )


def test_a12_is_the_chance_that_the_second_sample_is_lower() -> None:
    """With the interval of `superiority`, which leaves separated samples room for doubt; Cliff's delta doubles it."""
    measures = effects([4, 5, 6], [1, 2, 3], rng=np.random.default_rng(0))
    assert superiority([1, 2, 3], [4, 5, 6]).columns("a12").items() <= measures.items()
    assert (measures["a12"], measures["a12_high"]) == (1, 1)
    assert 0.4 < measures["a12_low"] < 0.6


@given(SAMPLES, SAMPLES)
def test_chance_lies_in_its_interval_and_mirrors(x: list[float], y: list[float]) -> None:
    """Low, estimate and high are in order and in [0, 1]; from the other side all three are reflected."""
    here, there = superiority(x, y), superiority(y, x)
    assert 0 <= here.low <= here.estimate <= here.high <= 1
    assert (here.estimate, here.low, here.high) == pytest.approx((1 - there.estimate, 1 - there.high, 1 - there.low))


@pytest.mark.parametrize(("n", "m"), [(1, 1), (5, 5), (20, 20), (5, 20)])
def test_ends_solve_newcombes_equation(n: int, m: int) -> None:
    """Both ends of an interval are z standard deviations of their own variance away from the estimate."""
    rng = np.random.default_rng(n)
    measure = superiority(rng.normal(size=n), rng.normal(0.5, size=m))
    for end in {measure.low, measure.high} - {0.0, 1.0}:
        more = (n + m) / 2 - 1
        variance = end * (1 - end) * (1 + more * (1 - end) / (2 - end) + more * end / (1 + end)) / (n * m)
        assert abs(end - measure.estimate) == pytest.approx(norm.ppf(0.975) * np.sqrt(variance), rel=1e-5)


def test_separated_samples_leave_room_for_doubt() -> None:
    """Five seeds that all beat five others show a chance of 1, and rule out a half only; one seed rules out nothing."""
    separated = superiority(range(5), range(10, 15))
    assert (separated.estimate, separated.high) == (1, 1)
    assert 0.5 < separated.low < 0.8
    assert superiority([1.0], [2.0]).low < 0.5


def test_values_that_are_not_finite_name_their_seeds() -> None:
    """Of either sample."""
    with pytest.raises(ValueError, match=r"x is not finite for seeds \[1\]"):
        effects([1, np.nan, 3], [1, 2, 3], rng=np.random.default_rng(0))
    with pytest.raises(ValueError, match=r"y is not finite for seeds \[0\]"):
        effects([1, 2], [np.inf, 3], rng=np.random.default_rng(0))


def test_median_of_few_values_has_their_range_as_interval() -> None:
    """By hand: all of n values lie on one side of the median with a chance of 2 / 2^n."""
    interval = median([5, 1, 4, 2, 3])
    assert (interval.estimate, interval.low, interval.high) == (3, 1, 5)
    assert [median_confidence(n) for n in (2, 3, 5)] == [0.5, 0.75, 0.9375]


@pytest.mark.parametrize(("n", "low", "high"), [(6, 1, 6), (7, 1, 7), (8, 1, 8), (9, 2, 8), (12, 3, 10), (20, 6, 15)])
def test_median_has_the_interval_of_the_tables(n: int, low: int, high: int) -> None:
    """The ranks that textbooks print for the sign test at 95 %; of seven, the second and the sixth are too near."""
    interval = median(list(range(n, 0, -1)))
    assert (interval.low, interval.high) == (low, high)
    assert median_confidence(n) >= 0.95


@pytest.mark.parametrize("n", [5, 7, 9, 20])
def test_interval_of_a_median_holds_it_as_often_as_said(n: int) -> None:
    """Of 4,000 skewed samples, within three standard errors."""
    samples = np.random.default_rng(n).exponential(size=(4_000, n))
    intervals = [median(sample) for sample in samples]
    held = np.mean([one.low <= np.log(2) <= one.high for one in intervals])
    chance = median_confidence(n)
    assert held == pytest.approx(chance, abs=3 * (chance * (1 - chance) / 4_000) ** 0.5)
