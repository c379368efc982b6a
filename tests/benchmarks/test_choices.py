"""Promise: a way to choose pays for every epoch that it looks at, and what it has looked at does not judge it."""

from pathlib import Path

import numpy as np
import pytest
from made_up import TINY, made_up_table

from benchmarks.choices import Choices, Drawn
from benchmarks.reach import Space

pytestmark = pytest.mark.room("table")


class _Counted(np.ndarray):  # type: ignore[type-arg]
    """Losses that note which of them are read."""

    read: set[tuple[int, int, int]]

    def __getitem__(self, key: object) -> object:
        if isinstance(key, tuple) and len(key) == 3:
            rows, seeds, epoch = np.broadcast_arrays(*key)
            self.read.update(zip(rows.tolist(), seeds.tolist(), epoch.tolist(), strict=True))
        return np.asarray(self)[key]


def test_ways_pay_for_what_they_see_and_are_judged_by_the_rest(place: Path) -> None:
    """Epochs of the trainings that were read are no more than the budget; every seed that was read is named."""
    space = Space(made_up_table(place / "table.zip", *TINY, "training.epochs=20"))
    choices = Choices(space)
    choices.logs = choices.logs.view(_Counted)
    for name, way in choices.ways().items():
        for budget in (30, 40):
            choices.logs.read = set()
            chosen = way(Drawn(space, 1), budget)
            longest: dict[tuple[int, int], int] = {}
            for row, seed, epoch in choices.logs.read:
                longest[row, seed] = max(longest.get((row, seed), 0), epoch + 1)
            assert 0 < sum(longest.values()) <= budget, name
            seen = {seed for row, seed in longest if row == chosen.network}
            assert seen <= set(chosen.seen), name
            assert len(chosen.seen) < space.tests.shape[1], name


def test_equal_luck_hands_over_the_same(place: Path) -> None:
    """A search is its seed."""
    space = Space(made_up_table(place / "table.zip", *TINY, "training.epochs=20"))
    for way in Choices(space).ways().values():
        assert way(Drawn(space, 3), 40) == way(Drawn(space, 3), 40)
