"""Promise: a sweep tells a search from what is worse, and not from itself."""

import pytest

from benchmarks.evidence_power import OTHER_SEEDS, SAME_SEEDS, Told, power_table, told
from benchmarks.landscape import Landscape

#: A control that finds nothing at all: one step from the baseline.
WORST = "random_parents_only_baseline"


def by_arm(found: list[Told], metric: str = "test score") -> dict[str, Told]:
    """Return the rates of one metric."""
    return {one.arm: one for one in found if one.metric == metric}


@pytest.mark.slow
def test_search_is_not_told_from_itself() -> None:
    """More often than one time in twenty and chance, by test scores and by records, with the same seeds or others."""
    landscape = Landscape(signal=1.0, noise=0.3)
    found = told(landscape, sweeps=25, jobs=[4], trainings=15, families=[(SAME_SEEDS,), (OTHER_SEEDS,)])
    assert len(found) == 4
    for one in found:
        assert (one.worse + one.better) / one.sweeps <= one.bound


@pytest.mark.slow
def test_search_is_told_from_a_control_that_finds_nothing() -> None:
    """Eight jobs do after Holm over two arms, and four cannot: their least p is 2/70."""
    landscape = Landscape(signal=1.0, noise=0.1)
    found = told(landscape, sweeps=4, jobs=[4, 8], trainings=80, families=[(WORST, OTHER_SEEDS)])
    few, many = (by_arm([one for one in found if one.jobs == jobs])[WORST] for jobs in (4, 8))
    assert (few.worse, few.better) == (0, 0)
    assert many.worse >= 3


def test_table_has_a_row_for_each_noise_and_arm() -> None:
    """With the rates of both directions, and an interval for both together."""
    lines = list(power_table([0.2], sweeps=1, jobs=[2], trainings=5))
    rows = [line for line in lines if line.startswith("| 0.2 ")]
    assert len(rows) == 7
    assert all("0 / 0 [0, 79]" in row for row in rows)
