"""Promise: the planned seeds find the effect as often as wished, by the tests that the finished study will use."""

import math

import numpy as np
import pytest

from analysis.statistics.planning import MOST, Spread, chance, median_deviation, needed, pooled
from analysis.statistics.tests import holm, mann_whitney, p_values


@pytest.mark.parametrize(("n", "m"), [(2, 2), (4, 5), (20, 20), (33, 33), (40, 40)])
def test_p_of_every_u_is_that_of_the_test(n: int, m: int) -> None:
    """Counted and normal, at the ends, in the middle and in between."""
    table, draw = p_values(n, m), np.random.default_rng(0)
    assert table.shape == (n * m + 1,)
    for shift in (-9, -1, 0, 0.5, 9):
        test = mann_whitney(draw.normal(shift, size=n), draw.normal(size=m))
        assert table[int(test.u)] == pytest.approx(test.p, rel=1e-8)
    assert table.max() <= 1


def test_chance_is_that_of_the_tests_one_by_one() -> None:
    """Three arms of eight seeds, of which one is shifted: 400 families, each by Mann and Whitney and by Holm."""
    draw, rejected = np.random.default_rng(1), 0
    for _ in range(400):
        reference, others = draw.normal(size=8), draw.normal(size=(3, 8))
        others[0] += 1.6
        rejected += holm([mann_whitney(other, reference).p for other in others])[0] <= 0.05
    assert chance(8, shift=1.6, comparisons=3, alpha=0.05) == pytest.approx(rejected / 400, abs=0.075)


def test_chance_without_an_effect_is_an_error_of_the_first_kind() -> None:
    """Of one arm of three, no more than alpha; and with several arms an effect is found less often."""
    assert chance(10, shift=0.0, comparisons=3, alpha=0.05) <= 0.05
    one, four = (chance(20, shift=1.0, comparisons=number, alpha=0.05) for number in (1, 4))
    assert four < one


def test_needed_seeds_are_the_fewest() -> None:
    """One less does not reach the power; by Noether's formula, which is cautious, twenty find 0.98 deviations."""
    seeds, reached = needed(shift=0.98, comparisons=1, alpha=0.05, power=0.8)
    assert seeds is not None
    assert 15 <= seeds <= 20
    assert reached >= 0.8 > chance(seeds - 1, shift=0.98, comparisons=1, alpha=0.05)


@pytest.mark.parametrize(("comparisons", "seeds"), [(1, 4), (4, 5)])
def test_an_effect_without_spread_needs_what_significance_needs(comparisons: int, seeds: int) -> None:
    """By hand: 2 / C(8, 4) is the first below 0.05, 2 / C(10, 5) the first below a quarter of it."""
    assert needed(shift=math.inf, comparisons=comparisons, alpha=0.05, power=0.8)[0] == seeds


def test_hopeless_effect_has_no_number() -> None:
    """It is not the largest number that was tried."""
    seeds, reached = needed(shift=0.01, comparisons=1, alpha=0.05, power=0.8)
    assert seeds is None
    assert reached == chance(MOST, shift=0.01, comparisons=1, alpha=0.05) < 0.2


def test_equal_questions_have_equal_answers() -> None:
    """Whatever was drawn elsewhere."""
    first = chance(12, shift=1.0, comparisons=2, alpha=0.05)
    np.random.default_rng(5).normal(size=100)
    assert chance(12, shift=1.0, comparisons=2, alpha=0.05) == first


def test_spread_is_pooled_within_samples() -> None:
    """By hand: squares 2 and 8 over three degrees of freedom; the distance between the samples does not count."""
    spread = pooled([[0.0, 2.0], [100.0, 102.0, 104.0]])
    assert spread == Spread(deviation=1.82574186, freedom=3)
    assert pooled([]) is None


def test_upper_limit_by_hand() -> None:
    """The fifth part of chi-squared with four degrees of freedom lies below 1.64878."""
    assert Spread(deviation=2.0, freedom=4).upper == pytest.approx(2 * math.sqrt(4 / 1.64878), rel=1e-5)
    draws = np.random.default_rng(2).normal(size=(2000, 5))
    held = [limit.upper > 1 for sample in draws if (limit := pooled([sample])) is not None]
    assert np.mean(held) == pytest.approx(0.8, abs=0.03)


def test_median_of_seeds_spreads_less() -> None:
    """Of one, as it does; of three and five by the tables of order statistics: 0.6698 and 0.5356."""
    assert [round(median_deviation(seeds), 2) for seeds in (1, 3, 5)] == [1.0, 0.67, 0.54]
