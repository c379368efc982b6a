"""Promise: tests err as often as they say, and intervals hold the truth: a quick part of `benchmarks.evidence`."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import ndtri

from analysis.statistics.effects import effects, median, superiority
from analysis.statistics.tests import equivalence, holm, mann_whitney
from analysis.table import Interval

TRIALS = 200

#: Two standard errors of a rate of 5 % in so many trials, and a little.
CHANCE = 0.035

Draw = np.random.Generator


def differs(rng: Draw) -> bool:
    """Call any of four networks that do not differ another than the baseline."""
    samples = rng.normal(size=(5, 20))
    return min(holm([mann_whitney(sample, samples[0]).p for sample in samples[1:]])) <= 0.05


def equals(rng: Draw) -> bool:
    """Call a network equivalent that is worse by just the margin."""
    return equivalence(1.05 + 0.05 * rng.normal(size=20), 1 + 0.05 * rng.normal(size=20), margin=0.05)[0] <= 0.05


def chosen_by_its_own_seeds_differs(rng: Draw, *, fresh: bool) -> bool:
    """Choose the best of twenty networks that do not differ, and test it by the seeds that chose it, or by others."""
    losses = rng.normal(size=(21, 20))
    best = 1 + int(np.median(losses[1:], axis=1).argmin())
    one, other = rng.normal(size=(2, 20)) if fresh else losses[[0, best]]
    return mann_whitney(one, other).p <= 0.05


def missed(interval: Interval | None, truth: float) -> bool:
    """Answer whether an interval of 95 % does not hold the truth."""
    return interval is None or not interval.low <= truth <= interval.high


def difference_missed(rng: Draw) -> bool:
    """Of the medians of two normal samples."""
    measures = effects(rng.normal(1, size=20), rng.normal(size=20), rng=rng, resamples=200)
    return not measures["difference_low"] <= 1 <= measures["difference_high"]


def icc_missed(rng: Draw) -> bool:
    """Of the part of the variance that is the networks'."""
    from analysis.statistics.seed_noise import icc

    levels = np.sqrt(0.64) * rng.normal(size=(5, 1))
    return missed(icc(np.exp(levels + np.sqrt(0.36) * rng.normal(size=(5, 20)))), 0.64)


ERRORS: dict[str, Callable[[Draw], bool]] = {
    "Mann-Whitney, Holm over 4 variants": differs,
    "equivalence at the margin": equals,
    "elites tested by seeds of their own": lambda rng: chosen_by_its_own_seeds_differs(rng, fresh=True),
    "difference of medians": difference_missed,
    "median": lambda rng: missed(median(rng.normal(size=20)), 0),
    "A12": lambda rng: missed(superiority(rng.normal(size=20), np.sqrt(2) * ndtri(0.8) + rng.normal(size=20)), 0.8),
    "ICC": icc_missed,
}


def rate(trial: Callable[[Draw], bool]) -> float:
    """Return in which part of the trials something is so."""
    rng = np.random.default_rng(0)
    return sum(trial(rng) for _ in range(TRIALS)) / TRIALS


@pytest.mark.few(3)
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.room("noise")) if name == "ICC" else name for name in ERRORS]
)
def test_rate_of_errors_is_five_per_cent_at_most(name: str) -> None:
    """Within chance."""
    assert rate(ERRORS[name]) <= 0.05 + CHANCE


def test_choosing_and_testing_by_the_same_seeds_would_err() -> None:
    """Which is why noise runs and studies have seeds of their own."""
    assert rate(lambda rng: chosen_by_its_own_seeds_differs(rng, fresh=False)) > 0.12
