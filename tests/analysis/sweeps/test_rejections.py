"""Promise: rates of rejection are those of the tests of `tacevo ablations`, over sweeps that share no search."""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from scipy.stats import beta

from analysis.statistics.effects import proportion
from analysis.sweeps.ablation import as_jobs, compare_arms
from analysis.sweeps.arm_metrics import Metric
from analysis.sweeps.rejections import RATES, rejection_rates


def _jobs(count: int, **arms: Callable[[int], float]) -> pd.DataFrame:
    """Make so many runs of each arm, every one another search, whose best fitness follows from its seed."""
    return as_jobs(
        {"job": f"{arm}-seed{seed}", "arm": arm, "seed": seed, "search": (arm, seed), "best_fitness": value(seed)}
        for arm, value in arms.items()
        for seed in range(count)
    )


def _rate(rates: pd.DataFrame, arm: str, against: str) -> tuple[int, int]:
    (row,) = rates[(rates.arm == arm) & (rates.against == against)].to_dict("records")
    return row["rejected"], row["sweeps"]


def test_arms_that_lie_apart_are_always_told_apart_and_an_arm_never_from_itself() -> None:
    """Four seeds each that do not overlap have p = 2 / 70; seeds left over are in no sweep."""
    values = [0.1, 0.4, 0.2, 0.3]
    jobs = _jobs(18, none=lambda seed: values[seed % 4] + seed / 1e6, better=lambda seed: seed / 1e3)
    rates = rejection_rates(jobs, seeds=4)
    assert dict(rates.dtypes.astype(str)) == RATES
    assert set(rates.metric) == {"best_fitness"}
    assert _rate(rates, "better", "none") == (4, 4)
    assert _rate(rates, "none", "none") == (0, 2)
    # Its values rise with the seed, so any two of its samples lie apart.
    assert _rate(rates, "better", "better") == (2, 2)


def test_each_rejection_is_one_that_the_comparison_of_that_sweep_makes() -> None:
    """The tests are not a copy of those of `tacevo ablations`."""
    rng = np.random.default_rng(1)
    draws = {arm: rng.normal(shift, 1, 20) for arm, shift in {"none": 0.0, "one": 0.8, "two": 1.6}.items()}
    jobs = _jobs(20, **{arm: lambda seed, values=values: float(values[seed]) for arm, values in draws.items()})
    rates = rejection_rates(jobs, seeds=5)
    blocks = [jobs[jobs.seed.isin(range(start, start + 5))] for start in range(0, 20, 5)]
    frames = [compare_arms(block).arms[Metric.best_fitness] for block in blocks]
    for arm in ("one", "two"):
        assert _rate(rates, arm, "none") == (sum(frame.at[arm, "p_holm"] < 0.05 for frame in frames), 4)
    assert 0 < _rate(rates, "two", "none")[0] <= 4


def test_equal_searches_are_never_told_apart() -> None:
    """What is not tested is not rejected."""
    jobs = _jobs(8, none=float, twin=float)
    jobs["search"] = jobs.seed
    assert _rate(rejection_rates(jobs, seeds=4), "twin", "none") == (0, 2)


@pytest.mark.parametrize(("count", "seeds", "rows"), [(3, 4, 0), (5, 4, 1), (8, 4, 3)])
def test_too_few_seeds_give_no_row(count: int, seeds: int, rows: int) -> None:
    """One small sweep compares two arms, and two are needed to compare one with itself."""
    assert len(rejection_rates(_jobs(count, none=float, other=float), seeds=seeds)) == rows


@pytest.mark.parametrize(("hits", "of"), [(0, 10), (3, 10), (10, 10)])
def test_interval_of_a_proportion_is_exact(hits: int, of: int) -> None:
    """Its ends are quantiles of beta distributions (Clopper and Pearson 1934)."""
    low = beta.ppf(0.025, hits, of - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, of - hits) if hits < of else 1.0
    told = proportion(hits, of)
    assert (told.estimate, told.low, told.high) == pytest.approx((hits / of, low, high), abs=1e-9)
