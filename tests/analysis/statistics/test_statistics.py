"""Promise: tests and corrections agree with SciPy, statsmodels and counting by hand, and say how they came about."""

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import fisher_exact, mannwhitneyu
from statsmodels.stats.descriptivestats import sign_test

from analysis.statistics.tests import (
    Alternative,
    Method,
    blocked_mann_whitney,
    holm,
    hypergeometric_p,
    mann_whitney,
    sign_p,
    smallest_p,
)

SIDES: tuple[Alternative, ...] = ("two-sided", "greater", "less")
#: Few different values, so that most samples have ties.
TIED = st.lists(st.integers(0, 4).map(float), min_size=2, max_size=6)


def pairs_won(x: Sequence[float], y: Sequence[float]) -> float:
    """Count U by its definition."""
    return sum((a > b) + (a == b) / 2 for a in x for b in y)


def counted_by_hand(x: Sequence[float], y: Sequence[float], side: Alternative) -> float:
    """Deal the values out in every possible way, and count the deals that are as extreme."""
    values, here = [*x, *y], pairs_won(x, y)
    deals = []
    for chosen in itertools.combinations(range(len(values)), len(x)):
        others = [value for at, value in enumerate(values) if at not in chosen]
        deals.append(pairs_won([values[at] for at in chosen], others))
    less = sum(deal <= here for deal in deals) / len(deals)
    greater = sum(deal >= here for deal in deals) / len(deals)
    return {"less": less, "greater": greater, "two-sided": min(1.0, 2 * min(less, greater))}[side]


def test_three_against_three_by_hand() -> None:
    """Full separation of 3 and 3: U is 0, and 2 of the 20 orders are as extreme."""
    test = mann_whitney([1, 2, 3], [4, 5, 6])
    assert (test.u, test.p, test.method) == (0, 0.1, Method.exact)


@pytest.mark.parametrize("side", SIDES)
def test_exact_p_is_scipys_without_ties(side: Alternative) -> None:
    """Twenty seeds against twenty, as in a study."""
    draw = np.random.default_rng(1)
    x, y = draw.normal(size=20), draw.normal(0.6, size=20)
    test, library = mann_whitney(x, y, alternative=side), mannwhitneyu(x, y, alternative=side, method="exact")
    assert test.method is Method.exact
    assert test.u == library.statistic
    assert test.p == pytest.approx(library.pvalue, rel=1e-8)


@given(TIED, TIED, st.sampled_from(SIDES))
def test_p_is_the_share_of_deals_as_extreme(x: list[float], y: list[float], side: Alternative) -> None:
    """With ties and without, for every side, p is what counting all deals gives."""
    test = mann_whitney(x, y, alternative=side)
    assert test.u == pairs_won(x, y)
    assert test.p == pytest.approx(counted_by_hand(x, y, side), rel=1e-8)


def test_ties_of_two_times_twenty_are_counted() -> None:
    """Accuracies of 351 images: SciPy's exact method would take them for distinct, its normal one is merely near."""
    x = np.array([351] * 14 + [350] * 6) / 351
    y = np.array([351] * 4 + [350] * 12 + [349] * 4) / 351
    test, near = mann_whitney(x, y), mannwhitneyu(x, y, method="asymptotic")
    assert test.method is Method.exact_ties
    assert test.p == pytest.approx(near.pvalue, rel=0.5)
    assert test.p != pytest.approx(near.pvalue, rel=1e-3)


@pytest.mark.parametrize("side", SIDES)
def test_what_cannot_be_counted_is_scipys_approximation(side: Alternative) -> None:
    """Above 66 values together the number of deals has no place in 64 bits."""
    draw = np.random.default_rng(2)
    x, y = draw.normal(size=34).round(1), draw.normal(0.5, size=34).round(1)
    test = mann_whitney(x, y, alternative=side)
    assert test.method is Method.normal
    assert test.p == pytest.approx(mannwhitneyu(x, y, alternative=side, method="asymptotic").pvalue, rel=1e-8)
    assert mann_whitney(x[:33], y[:33]).method is not Method.normal


@pytest.mark.parametrize("size", [5, 40])
@pytest.mark.parametrize("side", SIDES)
def test_identical_values_give_no_evidence(size: int, side: Alternative) -> None:
    """Where all values are one, every deal is as extreme, and p is 1 and no division by 0."""
    assert mann_whitney([0.5] * size, [0.5] * size, alternative=side).p == 1


@given(TIED, TIED)
def test_exchanging_the_samples_mirrors_u(x: list[float], y: list[float]) -> None:
    """U of both sides adds up to all pairs, and two-sided p is the same."""
    there, back = mann_whitney(x, y), mann_whitney(y, x)
    assert there.u + back.u == len(x) * len(y)
    assert there.p == pytest.approx(back.p)


@given(TIED, TIED, TIED, TIED)
def test_blocked_p_is_the_share_of_deals_within_blocks(
    x: list[float], y: list[float], above: list[float], below: list[float]
) -> None:
    """Every deal of one block beside every deal of the other, counted; ranks of different blocks never meet."""
    blocks = [(x[:4], y[:4]), (above[:4], below[:4])]
    test = blocked_mann_whitney([([100 + value for value in blocks[0][0]], [100 + v for v in blocks[0][1]]), blocks[1]])
    each = []
    for first, second in blocks:
        values = [*first, *second]
        deals = itertools.combinations(range(len(values)), len(first))
        each.append(
            [
                pairs_won([values[at] for at in deal], [one for at, one in enumerate(values) if at not in deal])
                for deal in deals
            ]
        )
    here, sums = test.u, [one + other for one, other in itertools.product(*each)]
    assert here == sum(pairs_won(*block) for block in blocks)
    tails = (sum(deal <= here for deal in sums), sum(deal >= here for deal in sums))
    assert test.p == pytest.approx(min(1.0, 2 * min(tails) / len(sums)))


@pytest.mark.parametrize("size", [20, 40])
def test_a_second_block_is_more_evidence(size: int) -> None:
    """Of the same values on another level; counted, and of too many values approximated."""
    draw = np.random.default_rng(2)
    x, y = draw.normal(size=size).round(1), draw.normal(0.4, size=size).round(1)
    assert blocked_mann_whitney([(x, y), (x + 9, y + 9)]).p < mann_whitney(x, y).p


def test_sign_test_is_statsmodels() -> None:
    """Ties are left out; without a case there is no evidence."""
    for better, worse in ((6, 0), (3, 1), (2, 9), (4, 4)):
        library = sign_test([1.0] * better + [-1.0] * worse + [0.0] * 3)[1]
        assert sign_p(better, worse) == pytest.approx(library)
    assert sign_p(0, 0) == 1


@pytest.mark.parametrize("bad", [[1.0, np.nan, 2.0, np.inf], [np.nan] * 3])
def test_values_that_are_not_finite_name_their_seeds(bad: list[float]) -> None:
    """A NaN is neither above nor below anything, so nothing is computed with it."""
    seeds = [at for at, value in enumerate(bad) if not np.isfinite(value)]
    with pytest.raises(ValueError, match=rf"y is not finite for seeds \[{str(seeds)[1:-1]}\]; drop or rerun"):
        mann_whitney([1, 2, 3], bad)


@pytest.mark.parametrize("bad", [[], [1.0], [[1.0, 2.0]]])
def test_wrong_shapes_are_refused(bad: list[float]) -> None:
    """One value has no spread, and a table of values is not a sample."""
    with pytest.raises(ValueError, match=r"x must have shape \(n,\) with n >= 2 seeds; got shape"):
        mann_whitney(bad, [1, 2, 3])


def test_holm_by_hand() -> None:
    """0.01 x 4 = 0.04; 0.02 x 3 = 0.06; 0.022 x 2 = 0.044, but no less than 0.06; 0.5."""
    assert holm([0.5, 0.02, 0.01, 0.022]) == (0.5, 0.06, 0.04, 0.06)


@settings(max_examples=20)  # statsmodels collects garbage at each call, which takes its time
@given(st.lists(st.floats(0, 1), min_size=1, max_size=8))
def test_holm_never_reverses_an_order(p_values: list[float]) -> None:
    """In the given order: the k-th smallest of m is the greatest of all (m - j + 1) p_j with j <= k, or 1."""
    corrected, ordered = holm(p_values), sorted(p_values)
    steps = [(len(ordered) - place) * p for place, p in enumerate(ordered)]
    wanted = {p: min(1.0, max(steps[: place + 1])) for place, p in enumerate(ordered)}
    assert corrected == pytest.approx([wanted[p] for p in p_values], rel=1e-8)


@pytest.mark.parametrize("bad", [[], [0.5, np.nan], [-0.1], [1.1]])
def test_holm_refuses_what_is_no_probability(bad: list[float]) -> None:
    """Nothing, NaN, and what lies outside [0, 1]."""
    with pytest.raises(ValueError, match=r"needs one or more p-values in \[0, 1\]; got"):
        holm(bad)


@pytest.mark.parametrize(
    ("hits", "drawn", "marked", "population"), [(8, 18, 18, 164), (13, 20, 63, 205), (0, 4, 16, 164), (4, 4, 123, 164)]
)
def test_hypergeometric_p_is_counted(hits: int, drawn: int, marked: int, population: int) -> None:
    """The share of all draws that hold so many marked ones or more; it is also Fisher's exact test, one-sided."""
    draws = sum(
        math.comb(marked, some) * math.comb(population - marked, drawn - some)
        for some in range(hits, min(drawn, marked) + 1)
    )
    p = hypergeometric_p(hits, drawn=drawn, marked=marked, population=population)
    assert p == pytest.approx(draws / math.comb(population, drawn), rel=1e-8)
    rows = np.array([[hits, drawn - hits], [marked - hits, population - marked - drawn + hits]])
    assert p == pytest.approx(fisher_exact(rows, alternative="greater").pvalue, rel=1e-8)


def test_smallest_p_is_that_of_full_separation() -> None:
    """No sample can do better than to lie above the other as a whole."""
    assert smallest_p(4, 4) == mann_whitney([1, 2, 3, 4], [5, 6, 7, 8]).p
