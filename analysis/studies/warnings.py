"""Warnings for the reader of a comparison: assumptions that a pair of samples, or a study, does not meet."""

from collections.abc import Callable, Iterable
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from analysis.rounding import shown
from analysis.statistics.image_statistics import detectable_lead
from analysis.statistics.tests import Method, detectable, smallest_p
from analysis.table import Percent
from tacevo.results.study_lines import fewest_groups
from tacevo.text import counted, listed

#: Interquartile ranges further apart than this count as very different; equal normal spreads of 20 seeds are further
#: apart about once in twenty.
SPREADS = 2.0

#: The effects that a test of too few values detects, in words.
_NOTHING = "no effect at all"
_NEAR_SEPARATION = "effects near full separation only, since Noether's formula gives none for so few"


class Caution(StrEnum):
    """An assumption that fails; the values are what a table says."""

    equal_values = "all values of a sample are equal, so its seeds show no spread"
    ties = "values tie, so p is counted over midranks"
    approximate = "p is a normal approximation, since there are too many values to count"
    spreads = (
        "the quartiles lie more than twice as far apart in one sample, so the test is one of dominance, not of medians"
    )
    wide_margin = (
        "the margin of equivalence is at least as wide as all errors of the baseline, so even a network without an "
        "error would lie within it (margins.classification.kind=errors states it as a part of them)"
    )
    ceiling = (
        "the baseline is at the ceiling: what it lacks to the most that any network can expect on these data is less "
        "than the margin, or than chance moves on so many test images, so next to nothing is left to win"
    )
    few_seeds = "no result of so few seeds is significant after Holm's correction"


def cautions(x: ArrayLike, y: ArrayLike, *, method: Method, least_p: float, alpha: float) -> tuple[Caution, ...]:
    """List what a reader of a comparison of two samples has to beware of.

    Args:
        x: shape (n,), n >= 2.
        y: shape (m,), m >= 2.
        method: how the p of their test came about.
        least_p: the smallest p that so many values can reach, after its correction.
        alpha: the level that a corrected p is held to.
    """
    narrow, wide = sorted(
        float(np.diff(np.quantile(np.asarray(one, dtype=np.float64), [0.25, 0.75]))[0]) for one in (x, y)
    )
    conditions = {
        Caution.equal_values: min(np.ptp(x), np.ptp(y)) == 0,
        Caution.ties: method is Method.exact_ties,
        Caution.approximate: method is Method.normal,
        Caution.spreads: wide > SPREADS * narrow,
        Caution.few_seeds: least_p > alpha,
    }
    return tuple(caution for caution, holds in conditions.items() if holds)


def caution_notes(given: Iterable[tuple[str, Iterable[Caution]]]) -> tuple[str, ...]:
    """Write a sentence for each caution, with the names of all that it concerns."""
    concerned: dict[Caution, list[str]] = {}
    for name, own in given:
        for caution in own:
            concerned.setdefault(caution, []).append(name)
    return tuple(f"{listed(names)}: {caution.value}." for caution, names in concerned.items())


def power_note(who: str, first: int, second: int, *, alpha: float, family: int) -> str:
    """Say which effect samples of two sizes, each of 2 at least, detect: in one test, and after Holm's correction.

    `who` names the samples in words; `family` is the number of tests.
    """
    return _power(who, lambda level: _detected(first, second, level), alpha=alpha, family=family)


def group_power_note(groups: int, *, alpha: float, family: int) -> str:
    """Say which effect a signed-rank test of so many groups of test images detects, as `power_note`."""
    return _power(counted(groups, "group"), lambda level: _lead_detected(groups, level), alpha=alpha, family=family)


def _power(who: str, detected: Callable[[float], str], *, alpha: float, family: int) -> str:
    one, strictest = detected(alpha), detected(alpha / family)
    head = f"Detected by {who} with a power of 80 %, in a single test"
    if one == strictest:
        return f"{head} and in the strictest step of Holm's correction: {one}."
    return f"{head}: {one}; in the strictest step of Holm's correction: {strictest}."


def _lead_detected(groups: int, alpha: float) -> str:
    if fewest_groups(alpha) > groups:
        return _NOTHING
    effect = detectable_lead(groups, alpha=alpha)
    if effect is None:
        return _NEAR_SEPARATION
    chance, shift = effect
    return (
        f"a mean difference of {shown(shift)} standard deviations between groups (two of them together favour the "
        f"better network in {shown(Percent(chance))} of pairs)"
    )


def _detected(first: int, second: int, alpha: float) -> str:
    effect = detectable(first, second, alpha=alpha)
    if effect is not None:
        a12, shift = effect
        return f"an A12 of {shown(a12)} or {shown(1 - a12)} ({shown(shift)} standard deviations)"
    return _NOTHING if smallest_p(first, second) > alpha else _NEAR_SEPARATION
