"""Promise: a search is charged for each network once, for what is trained again, and for itself."""

import math
from pathlib import Path

import pytest
from made_up import TINY, made_up_table

from benchmarks.confinement import Seconds
from benchmarks.reach import Losses, Trained, until

PRICE = Seconds(start=1, epoch=2)


@pytest.fixture
def losses(place: Path) -> Losses:
    """Take the losses of a table with three seeds."""
    return Losses(made_up_table(place / "table.zip", *TINY, "training.epochs=10", "training.seeds=3"))


def test_network_is_charged_once(losses: Losses) -> None:
    """The baseline again costs nothing; the time of the search is spread over all its trainings."""
    baseline, other = (Trained(row, 0, 5, fitness) for row, fitness in ((0, 2.0), (1, 1.0)))
    loss = (losses.again(baseline) + losses.again(other)) / 2
    assert losses.again(other) != losses.again(baseline)
    first, second = sorted((baseline, other), key=losses.again, reverse=True)
    again = 2 * sum(losses.seconds(each.network, 10, PRICE) for each in (first, second))
    once = losses.seconds(0, 5, PRICE) + losses.seconds(1, 5, PRICE)
    trained = [first, first, second, first]
    assert until(loss, losses, PRICE, trained, own=8.0) == pytest.approx(once + again + 6)


def test_first_network_may_be_good_enough(losses: Losses) -> None:
    """An epoch of the baseline has the measured price: five of its search and ten with each of two other seeds."""
    assert until(math.inf, losses, PRICE, [Trained(0, 0, 5, 1.0)], own=8.0) == 1 + 5 * 2 + 2 * (1 + 10 * 2) + 8


def test_search_may_never_be_there(losses: Losses) -> None:
    """Not a large number: a median stays right."""
    assert until(0.0, losses, PRICE, [Trained(0, 0, 5, 1.0)], own=0.0) == math.inf
