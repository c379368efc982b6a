"""Promise: tests and intervals over images are those of SciPy, and have equal bits everywhere."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import softmax
from scipy.stats import rankdata, wilcoxon

from analysis.statistics.image_statistics import (
    average,
    detectable_lead,
    drawn_again,
    mean_difference,
    predicted,
    probabilities,
    resampled_means,
    signed_rank,
    squared_errors,
)

#: A few sizes, so that differences tie and vanish.
ERRORS = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=1, max_size=9)


@given(ERRORS)
def test_signed_ranks_without_ties_are_counted(errors: list[tuple[int, int]]) -> None:
    """By every assignment of signs to the ranks; made distinct here, in the same order."""
    pairs = np.array(errors, dtype=float)
    pairs[:, 0] += 1e-3 * np.arange(1, len(pairs) + 1)
    test, differences = signed_rank(*pairs.T), np.subtract(*pairs.T)
    ranks = rankdata(np.abs(differences))
    sums = [ranks @ signs for signs in itertools.product((-1, 1), repeat=len(ranks))]
    here = abs(ranks @ np.sign(differences))
    if len(np.unique(ranks)) == len(ranks):
        assert test["p"] == pytest.approx(np.mean(np.abs(sums) >= here - 1e-9))
    assert test["lead"] == pytest.approx(-(ranks @ np.sign(differences)))


def test_tied_signed_ranks_are_scipys_approximation() -> None:
    """Corrected for ties and continuity, without the images on which both err equally."""
    rng = np.random.default_rng(0)
    first, second = rng.integers(0, 5, size=(2, 60)).astype(float)
    differences = (first - second)[first != second]
    expected = wilcoxon(differences, method="approx", correction=True).pvalue
    assert signed_rank(first, second)["p"] == pytest.approx(expected)
    many = rng.normal(size=(2, 300))
    assert signed_rank(many[0], many[1])["p"] == pytest.approx(
        wilcoxon(many[0], many[1], method="exact").pvalue, abs=1e-3
    )


def test_networks_that_err_alike_do_not_differ() -> None:
    """No division by nothing, and no warning."""
    assert signed_rank([1.0, 2.0], [1.0, 2.0])["p"] == 1.0


def test_smaller_error_on_more_images_is_not_always_ahead() -> None:
    """Ranks decide: better by a little on three images, worse by more on three."""
    test = signed_rank([1.0, 1.0, 1.0, 1.5, 8.0, 7.0], [1.1, 1.2, 1.3, 1.0, 1.0, 1.0])
    assert (test["better"], test["worse"]) == (3, 3)
    assert test["lead"] < 0


@given(ERRORS)
def test_groups_of_one_image_are_images(errors: list[tuple[int, int]]) -> None:
    """Not a bit of the test changes."""
    first, second = 0.1 * np.array(errors, dtype=float).T
    assert signed_rank(first, second, np.arange(len(first))) == signed_rank(first, second)


@given(st.integers(0, 99), st.integers(2, 5))
def test_copies_of_the_images_of_a_group_change_no_test(seed: int, copies: int) -> None:
    """Each image so many times, in any order: as many frames of one press say what one says."""
    rng = np.random.default_rng(seed)
    first, second = rng.exponential(size=(2, 24))
    groups, order = np.sort([*range(8), *rng.integers(8, size=16)]), rng.permutation(24 * copies)
    several = [np.repeat(each, copies)[order] for each in (first, second, groups)]
    assert signed_rank(*several) == signed_rank(first, second, groups)


def test_groups_are_tested_by_their_means() -> None:
    """SciPy's test of the mean differences, however many images a group has."""
    rng = np.random.default_rng(0)
    groups = np.repeat(np.arange(12), rng.integers(1, 6, size=12))
    first, second = rng.exponential(size=(2, len(groups)))
    means = [(first - second)[groups == group].mean() for group in range(12)]
    test = signed_rank(first, second, groups)
    assert test["p"] == pytest.approx(wilcoxon(means).pvalue, rel=1e-6)
    assert (test["better"], test["worse"]) == (sum(mean < 0 for mean in means), sum(mean > 0 for mean in means))


def test_images_of_a_group_are_drawn_together() -> None:
    """Of four equal frames each: the spread is that of the presses, twice as wide as of so many images alone."""
    rng = np.random.default_rng(0)
    presses, groups = rng.normal(size=40), np.repeat(np.arange(40), 4)
    apart, together = (
        resampled_means(presses[None, groups], weights, rng=rng).std()
        for weights in (drawn_again(160, rng=rng), drawn_again(40, rng=rng)[:, groups])
    )
    assert together == pytest.approx(presses.std() / np.sqrt(39), rel=0.06)
    assert together / apart == pytest.approx(2, rel=0.1)


def test_groups_keep_what_test_and_interval_promise() -> None:
    """Of two networks that err alike on other presses, by 15 presses of 3 frames; image by image neither is kept."""
    rng, presses, images = np.random.default_rng(0), np.repeat(np.arange(15), 3), np.arange(45)
    shown: dict[str, list[bool]] = {"presses": [], "images": []}
    covered: dict[str, list[bool]] = {"presses": [], "images": []}
    for _ in range(400):
        x, y = (rng.exponential(size=15)[presses] + 0.3 * rng.exponential(size=45) for _ in range(2))
        by_seed = [each + 0.3 * rng.normal(size=(5, 1)) for each in (x, y)]
        for name, groups in (("presses", presses), ("images", images)):
            shown[name].append(signed_rank(x, y, groups)["p"] <= 0.05)
            weights = drawn_again(int(groups.max()) + 1, rng=rng, resamples=399)[:, groups]
            drawn = [resampled_means(each, weights, rng=rng) for each in by_seed]
            between = mean_difference(*by_seed, *drawn)
            covered[name].append(between.low <= 0 <= between.high)
    assert np.mean(shown["presses"]) <= 0.08
    assert np.mean(shown["images"]) > 0.15
    assert 0.91 <= np.mean(covered["presses"]) <= 0.98
    assert np.mean(covered["images"]) < 0.88


def test_sums_over_groups_of_other_sizes_are_exact() -> None:
    """A resample that draws the largest group again and again has more images than there are."""
    rng = np.random.default_rng(0)
    groups = np.array([0] * 50 + [1, 2, 3, 4, 5])
    scores, weights = rng.exponential(size=(3, 55)), drawn_again(6, rng=rng, resamples=300)[:, groups]
    assert weights.sum(axis=1).max() > 55
    means = resampled_means(scores, weights, rng=np.random.default_rng(2))
    order = rng.permutation(55)
    assert (
        resampled_means(scores[:, order], weights[:, order], rng=np.random.default_rng(2)).tobytes() == means.tobytes()
    )
    drawn = np.random.default_rng(2).integers(3, size=(300, 2))
    exact = [np.average(scores[pair].mean(axis=0), weights=weight) for pair, weight in zip(drawn, weights, strict=True)]
    assert means == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("groups", [15, 40])
def test_effect_that_groups_detect_is_found_four_times_of_five(groups: int) -> None:
    """By simulation; Noether's formula is a little careful, as that of two samples is."""
    effect = detectable_lead(groups, alpha=0.05)
    assert effect is not None
    chance, shift = effect
    rng = np.random.default_rng(0)
    draws = rng.normal(size=(1000, groups)) + shift
    assert ((draws[:, 0] + draws[:, 1]) > 0).mean() == pytest.approx(chance, abs=0.03)
    found = np.mean([wilcoxon(draw).pvalue <= 0.05 for draw in draws])
    assert 0.78 <= found <= 0.95
    assert detectable_lead(5, alpha=0.05) is None


def test_resampled_means_by_hand() -> None:
    """With one seed and one image there is one mean; with equal scores, too."""
    rng = np.random.default_rng(0)
    weights = drawn_again(1, rng=rng, resamples=40)
    assert set(resampled_means([[0.3]], weights, rng=rng)) == {0.3}
    weights = drawn_again(7, rng=rng, resamples=40)
    assert set(weights.sum(axis=1)) == {6}
    assert resampled_means(np.full((3, 7), 0.1), weights, rng=rng) == pytest.approx(0.1)


def test_networks_without_an_error_have_means_of_0() -> None:
    """No score is divided by the largest one."""
    rng = np.random.default_rng(0)
    weights = drawn_again(3, rng=rng, resamples=39)
    assert resampled_means([[0.0] * 3] * 2, weights, rng=rng).tolist() == [0.0] * 39


def test_both_images_and_seeds_are_resampled() -> None:
    """Where images alone differ, or seeds alone, the means spread as the standard error."""
    rng = np.random.default_rng(0)
    images, seeds = np.tile(rng.normal(size=50), (20, 1)), np.tile(rng.normal(size=(20, 1)), (1, 50))
    weights = drawn_again(50, rng=rng)
    for scores, count in ((images, 50), (seeds, 20)):
        spread = resampled_means(scores, weights, rng=rng).std()
        assert spread == pytest.approx(scores.std() / np.sqrt(count - 1), rel=0.06)


def test_networks_are_tested_on_the_same_images() -> None:
    """What an image adds to both of them is not a part of their difference."""
    rng = np.random.default_rng(0)
    hard, weights = rng.normal(size=50), drawn_again(50, rng=rng)
    x, y = np.tile(hard + 1, (5, 1)), np.tile(hard, (5, 1))
    interval = mean_difference(x, y, *(resampled_means(each, weights, rng=rng) for each in (x, y)))
    assert (interval.low, interval.estimate, interval.high) == pytest.approx((1, 1, 1))


@given(st.integers(0, 99), st.sampled_from([1e-30, 1e-3, 1.0, 1e12]))
def test_sums_are_exact_in_any_order(seed: int, size: float) -> None:
    """Every mean is one of whole numbers, which a fraction gives to the last bit: so every CPU does."""
    rng = np.random.default_rng(seed)
    scores = size * rng.exponential(size=(4, 9))
    weights = drawn_again(9, rng=np.random.default_rng(1), resamples=39)
    means = resampled_means(scores, weights, rng=np.random.default_rng(2))
    backwards = resampled_means(scores[:, ::-1], weights[:, ::-1], rng=np.random.default_rng(2))
    assert means.tobytes() == backwards.tobytes()
    drawn = np.random.default_rng(2).integers(4, size=(39, 3))
    exact = [
        sum(Fraction(float(scores[s, i])) * int(w) for s in row for i, w in enumerate(weight)) / 24
        for row, weight in zip(drawn.tolist(), weights, strict=True)
    ]
    assert means == pytest.approx([float(value) for value in exact], rel=1e-9)


def test_average_and_squared_errors_by_hand() -> None:
    """Of two seeds on two images and two outputs."""
    mean = average([np.array([[1.0, 2.0], [3.0, 4.0]], np.float32), np.array([[3.0, 2.0], [3.0, 0.0]], np.float32)])
    assert mean.tolist() == [[2.0, 2.0], [3.0, 2.0]]
    assert squared_errors(mean, [[1.0, 2.0], [0.0, 2.0]]).tolist() == [0.5, 4.5]


def test_probabilities_are_scipys_softmax() -> None:
    """Without overflow; equal logits give equal probabilities, of which the first is predicted."""
    logits = np.random.default_rng(0).normal(size=(50, 5)) * 30
    assert probabilities(logits) == pytest.approx(softmax(logits, axis=1), abs=1e-12)
    assert probabilities([[1e30, 1e30, 0.0]]).tolist() == [[0.5, 0.5, 0.0]]
    assert predicted(np.array([[0.1, 0.1 + 0.2, 0.3, 0.3]])).tolist() == [1]
