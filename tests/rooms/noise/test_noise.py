"""Promise: what is said of a fitness's noise follows from published formulas, and nothing is said where none does."""

import math

import numpy as np
import pytest
from scipy.stats import f_oneway, kendalltau, spearmanr

from analysis.statistics.seed_noise import (
    agreement,
    deviations,
    expected,
    icc,
    noise,
    rankings,
    reliability,
    shrunken,
)

#: Six targets by four judges: the example of Shrout and Fleiss (1979), whose ICC(1) is 0.17.
SHROUT_FLEISS = [[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]]


def test_recorded_fitness_is_placed_among_its_draws() -> None:
    """By hand: a winner at 1 whose other seeds give 2, 3 and 4, against a reference of 2, 2 and 5."""
    frame = noise([3.0, 1.0], [[2.0, 2.0, 5.0], [2.0, 3.0, 4.0]])
    reference, winner = frame.itertuples()
    assert (winner.median, winner.least, winner.most, winner.as_low, winner.optimism) == (3, 2, 4, 0, -2)
    assert (reference.median, reference.as_low, reference.optimism) == (2, 2, 1)
    assert math.isnan(reference.beats)
    assert winner.beats == pytest.approx(4 / 9, abs=1e-9)  # 1/2 + 1/2 + 1 + 1 + 1 of nine pairs


def test_seed_that_ties_with_the_record_is_as_low() -> None:
    """Ties are usual for accuracies."""
    assert noise([1.0, 1.0], [[1.0, 2.0, 3.0], [1.0, 1.0, 0.5]]).as_low.tolist() == [1, 3]


def test_icc_is_that_of_shrout_and_fleiss() -> None:
    """Their example, as logarithms: 0.17, within [-0.13, 0.72]; by the F of a one-way analysis of variance."""
    correlation = icc(np.exp(SHROUT_FLEISS))
    assert correlation is not None
    ratio = f_oneway(*SHROUT_FLEISS).statistic
    assert correlation.estimate == pytest.approx((ratio - 1) / (ratio + 3))
    assert (correlation.estimate, correlation.low, correlation.high) == pytest.approx((0.166, -0.133, 0.723), abs=5e-4)


@pytest.mark.parametrize(
    ("losses", "reason"),
    [
        ([[1.0, 2.0, 3.0]], "one network"),
        ([[1.0], [2.0]], "one seed"),
        ([[2.0, 2.0], [2.0, 2.0]], "no variance"),
        ([[1e5, math.nextafter(1e5, 2e5)]] * 2, "no variance of the logarithms"),
        ([[0.0, 1.0], [2.0, 3.0]], "a loss without a logarithm"),
    ],
)
def test_icc_is_none_where_it_is_not_defined(losses: list[list[float]], reason: str) -> None:
    """Neither an error nor a number; and then nothing is expected of a recorded fitness."""
    assert icc(losses) is None, reason
    assert noise([1.0] * len(losses), losses).expected.isna().all()


def test_networks_without_noise_have_an_icc_of_one() -> None:
    """And their recorded fitness is what to expect."""
    correlation = icc([[1.0, 1.0], [2.0, 2.0]])
    assert correlation is not None
    assert (correlation.estimate, correlation.low, correlation.high) == (1, 1, 1)


def test_recorded_fitness_regresses_to_the_mean() -> None:
    """By the part that is not the network's: wholly at an ICC of 0 or below, not at all at 1, half way at one half."""
    estimates = [[1.0, 4.0], [1.0, 4.0]]  # of which the geometric mean is 2
    assert expected(8.0, estimates, 0.5) == pytest.approx(4)
    assert [expected(8.0, estimates, part) for part in (-0.5, 0.0, 1.0)] == pytest.approx([2, 2, 8])
    assert expected(0.0, estimates, 0.5) is None


def test_agreement_is_kendalls_tau_b() -> None:
    """With ties; and nothing where one side cannot be ranked."""
    x, y = [1, 2, 3, 4, 4], [2, 1, 3, 3, 5]
    assert agreement(x, y) == pytest.approx(kendalltau(x, y).statistic)
    assert agreement(x, y) != pytest.approx(spearmanr(x, y).statistic)
    assert agreement([1], [2]) is agreement([1, 1], [1, 2]) is agreement([1, 2], [3, 3]) is None


def test_each_side_of_a_ranking_has_seeds_of_its_own() -> None:
    """Networks that are all alike agree by the luck of a shared training only, and here no training is shared."""
    luck = np.random.default_rng(0).permutation(40).reshape(4, 10).astype(float)
    ranked = rankings(luck[:, :, None], luck)
    assert ranked is not None
    assert list(ranked["median"]) == [agreement(np.median(luck[:, ::2], axis=1), np.median(luck[:, 1::2], axis=1))]
    changed = luck.copy()
    changed[:, 1::2] = 0  # losses of the seeds that are tested, and scores of those that are not
    changed_scores = luck.copy()
    changed_scores[:, ::2] = 0
    assert ranked.equals(rankings(changed[:, :, None], changed_scores))


def test_rankings_follow_the_epochs() -> None:
    """A fitness that orders the networks wrongly at the first epoch and rightly at the second; one seed has none."""
    losses = np.array([[[3.0, 1.0]] * 2, [[2.0, 2.0]] * 2, [[1.0, 3.0]] * 2])
    scores = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])
    ranked = rankings(losses, scores)
    assert ranked is not None
    assert ranked.to_numpy().tolist() == [[1, -1, -1], [2, 1, 1]]
    assert rankings(losses[:, :1], scores[:, :1]) is None


def test_mean_of_noise_is_moved_to_the_middle() -> None:
    """By hand: two seeds that agree on nothing leave no difference between networks, and two that agree leave all."""
    agree, differ = np.array([[0.0, 0.0], [1.0, 1.0]]), np.array([[0.0, 1.0], [1.0, 0.0]])
    assert deviations(agree) == pytest.approx((0.5**0.5, 0))
    assert reliability(agree) == 1
    assert shrunken(agree) == pytest.approx([0, 1])
    assert (deviations(differ)[0], reliability(differ)) == (0.0, 0.0)
    assert shrunken(differ) == pytest.approx([0.5, 0.5])
    assert reliability(np.zeros((2, 2))) == 0


def test_deviations_are_those_of_made_up_values() -> None:
    """Of 4,000 networks with three seeds each; so is the reliability of a mean of three."""
    rng = np.random.default_rng(0)
    values = 0.3 * rng.standard_normal((4000, 1)) + 0.6 * rng.standard_normal((4000, 3))
    assert deviations(values) == pytest.approx((0.3, 0.6), abs=0.02)
    assert reliability(values) == pytest.approx(0.09 / (0.09 + 0.36 / 3), abs=0.03)
