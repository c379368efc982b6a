"""Promise: a search is charged for all it trains, and counts as successful where what it hands over is good."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from made_up import TINY, made_up_table

from benchmarks.confinement import Seconds
from benchmarks.reach import LONG, Space, Visit, Way, at_random, expected_seconds, reached, told

pytestmark = pytest.mark.room("table")

PRICE = Seconds(probe=0.5, start=0.5, epoch=2)

FREE = Seconds(probe=0, start=0, epoch=0)

WAY = Way(5, PRICE, PRICE, lambda seed: ([], 0.0))


@pytest.fixture
def space(place: Path) -> Space:
    """Return a space with three seeds."""
    return Space(made_up_table(place / "table.zip", *TINY, "training.epochs=10"))


def test_baseline_has_the_measured_price(space: Space) -> None:
    """Five epochs of its search, ten with each of two other seeds, and what the search took itself."""
    visits = [Visit(network=0, loss=1.0, seed=0, generation=0)]
    again = 2 * (0.5 + LONG * 2)
    assert reached(space, WAY, visits, own=8.0, level=math.inf) == ((0.5 + 5 * 2) + again + 8, True)
    assert reached(space, WAY._replace(price=FREE), visits, own=8.0, level=math.inf) == (again + 8, True)


def test_search_ends_after_the_generation_that_finds_a_good_network(space: Space) -> None:
    """Later generations are not charged, nor their part of the search's own time; the generation itself is, whole."""
    bad, good = int(space.test.argmax()), int(space.test.argmin())
    space.lowest[good] = space.lowest.min() - 1  # under each seed
    found = [(bad, 2.0, 0), (good, 1.0, 1), (0, 3.0, 1), (bad, 2.0, 2), (bad, 2.0, 2), (bad, 2.0, 2)]
    visits = [Visit(network, loss, 0, generation) for network, loss, generation in found]
    seconds, is_there = reached(space, WAY, visits, own=6.0, level=float(space.test[good]))
    whole = sum(space.seconds(visit, 5, PRICE) for visit in visits[:3])
    again = 2 * sum(space.seconds(visit, LONG, PRICE) for visit in visits[:3])
    assert is_there
    assert seconds == pytest.approx(whole + again + 4)


def test_fit_network_that_is_not_good_does_not_count(space: Space) -> None:
    """What is handed over is chosen by the losses of other seeds than its search's, and judged by test losses."""
    bad, good = int(space.test.argmax()), int(space.test.argmin())
    space.lowest[bad, 1:] = space.lowest.min() - 1
    visits = [Visit(good, 0.1, 0, 0), Visit(bad, 0.2, 0, 0)]
    assert not reached(space, WAY, visits, own=0.0, level=float(space.test[good]))[1]
    visits[1] = visits[1]._replace(seed=1)
    space.lowest[bad, 2] = np.inf  # of the seed that is left beside 0
    assert reached(space, WAY, visits, own=0.0, level=float(space.test[good]))[1]


def test_only_the_fittest_are_trained_again(space: Space) -> None:
    """A good network that is the sixth by its own search is not found."""
    good, *others = np.argsort(space.test)[:6]
    visits = [Visit(int(row), 1.0, 0, 0) for row in others] + [Visit(int(good), 2.0, 0, 0)]
    assert not reached(space, WAY, visits, own=0.0, level=float(space.test[good]))[1]


def test_search_in_vain_is_charged_to_those_that_succeed() -> None:
    """As ERT has it; without a success it is infinite."""
    assert expected_seconds([(10.0, True), (30.0, False), (20.0, True)]) == 30
    assert expected_seconds([(30.0, False)]) == math.inf


def test_interval_holds_the_figure() -> None:
    """It is told of enough searches alone, and is narrow where all are alike."""
    found = [(10.0 + number, number % 3 > 0) for number in range(30)]
    low, high = map(float, re.findall(r"(\d+) to (\d+)", told(found))[0])
    assert low < expected_seconds(found) < high
    assert told([(10.0, True)] * 10) == "10 of 10; 10 to 10"
    assert told(found[:3]) == "2 of 3"


def test_random_networks_are_distinct_and_pay_a_probe_each(space: Space) -> None:
    """Their losses are those of one seed of the table, which no re-estimate takes."""
    visits, own = at_random(space, 0, 4, 5, probe=0.5)
    assert own == 2
    assert len({visit.network for visit in visits}) == 4
    assert all(visit.loss == space.lowest[visit.network, visit.seed, 4] for visit in visits)
    assert visits != at_random(space, 1, 4, 5, probe=0.5)[0]
