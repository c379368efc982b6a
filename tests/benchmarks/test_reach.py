"""Promise: a search is charged for all it trains, and counts as successful where what it hands over is good."""

import math
from pathlib import Path

import numpy as np
import pytest
from made_up import TINY, made_up_table

from benchmarks.confinement import Seconds
from benchmarks.reach import LONG, Space, Visit, Way, expected_seconds, reached

PRICE = Seconds(probe=0.5, start=0.5, epoch=2)

WAY = Way(5, PRICE, lambda seed: ([], 0.0))


@pytest.fixture
def space(place: Path) -> Space:
    """Return a space with three seeds."""
    return Space(made_up_table(place / "table.zip", *TINY, "training.epochs=10", "training.seeds=3").path)


def test_baseline_has_the_measured_price(space: Space) -> None:
    """Five epochs of its search, ten with each of two other seeds, and what the search took itself."""
    seconds, good = reached(space, WAY, [Visit(0, 0, 0)], own=8.0, level=math.inf)
    assert seconds == (1 + 5 * 2) + 2 * (1 + LONG * 2) + 8
    assert good


def test_search_ends_after_the_generation_that_finds_a_good_network(space: Space) -> None:
    """Later generations are not charged, and their part of the search's own time neither; its generation is, whole."""
    by_loss = np.argsort(space.test)
    bad, good = int(by_loss[-1]), int(by_loss[0])
    space.lowest[good] = space.lowest.min() - 1  # the fittest, under each seed
    visits = [Visit(bad, 0, 0), Visit(good, 0, 1), Visit(0, 0, 1), *(Visit(bad, 0, 2) for _ in range(3))]
    seconds, found = reached(space, WAY, visits, own=6.0, level=float(space.test[good]))
    whole = sum(space.seconds(visit, 5, PRICE) for visit in visits[:3])
    again = 2 * sum(space.seconds(visit, LONG, PRICE) for visit in visits[:3])
    assert found
    assert seconds == pytest.approx(whole + again + 3)


def test_fit_network_that_is_not_good_does_not_count(space: Space) -> None:
    """What is handed over is chosen by validation losses, and judged by test losses."""
    bad = int(space.test.argmax())
    space.lowest[bad] = space.lowest.min() - 1
    _, found = reached(space, WAY, [Visit(int(space.test.argmin()), 0, 0), Visit(bad, 0, 0)], 0.0, space.test.min())
    assert not found


def test_search_in_vain_is_charged_to_those_that_succeed() -> None:
    """As ERT has it; without a success there is no figure."""
    assert expected_seconds([(10.0, True), (30.0, False), (20.0, True)]) == 30
    with pytest.raises(RuntimeError, match="none of 1"):
        expected_seconds([(30.0, False)])
