"""Promise: a way to choose pays for every epoch that it looks at, and what it has looked at does not judge it."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from checkout import ROOT
from made_up import TINY, made_up_table
from numpy.typing import NDArray

from benchmarks.choices import SEARCHED, Choices, Drawn, in_pilot, in_searches
from benchmarks.judging import Space
from benchmarks.pilot import Pilot

pytestmark = pytest.mark.room("table", "noise", "surrogate", "grammar")


class _Counted:
    """Losses that note which of them are read: the epochs of each training, by network and seed."""

    def __init__(self, logs: NDArray[np.float64]) -> None:
        self.logs, self.read = logs, dict[tuple[int, int], int]()

    def __getitem__(self, key: tuple[Any, ...]) -> NDArray[np.float64]:
        rows, seeds, epochs = np.broadcast_arrays(*key)
        for row, seed, epoch in zip(rows.tolist(), seeds.tolist(), epochs.tolist(), strict=True):
            self.read[row, seed] = max(self.read.get((row, seed), 0), epoch + 1)
        return np.asarray(self.logs[key])


def test_ways_pay_for_what_they_see_and_are_judged_by_the_rest(place: Path) -> None:
    """Epochs of the trainings that were read are no more than the budget; every seed that was read is named."""
    space = Space(made_up_table(place / "table.zip", *TINY, "training.epochs=20"))
    choices = Choices(space)
    logs = choices.logs
    for name, way in choices.ways().items():
        for budget in (30, 40):
            counted = _Counted(logs)
            choices.logs = counted  # type: ignore[assignment]
            chosen = way(Drawn(space, 1), budget)
            assert 0 < sum(counted.read.values()) <= budget, name
            seen = {seed for row, seed in counted.read if row == chosen.network}
            assert seen <= set(chosen.seen), name
            assert len(chosen.seen) < space.tests.shape[1], name


def test_equal_luck_hands_over_the_same(place: Path) -> None:
    """A search is its seed."""
    space = Space(made_up_table(place / "table.zip", *TINY, "training.epochs=20"))
    for way in Choices(space).ways().values():
        assert way(Drawn(space, 3), 40) == way(Drawn(space, 3), 40)


def test_estimate_is_judged_by_the_other_seed() -> None:
    """By hand: a lucky network of the worse kind is the fittest, and the model takes one of the better kind."""
    kinds = [{"kind": 1.0}] * 3 + [{"kind": 0.0}] * 3
    fitness = np.array([[0.5, 0.5], [0.51, 0.51], [0.52, 0.52], [0.2, 0.2], [2.0, 2.0], [2.1, 2.1]])
    tests = np.log(np.array([[0.5, 0.4]] * 3 + [[1.0, 0.9]] * 3))
    pilot = Pilot(pd.DataFrame({"kind": range(6)}), kinds, tests, fitness, late=0.0)
    assert in_pilot(pilot) == pytest.approx((np.log(0.5 / 1.0) + np.log(0.4 / 0.9)) / 2)
    assert in_pilot(pilot, networks=3) == 0


def test_published_searches_are_read() -> None:
    """A value for each of the eight seeds; both arms count in it."""
    assert len(in_searches(str(ROOT / SEARCHED))) == 8
