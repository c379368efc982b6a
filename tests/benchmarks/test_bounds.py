"""Promise: parents by a lower bound are those that a model expects to be good, however lucky others were."""

import json
import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from checkout import ROOT

from benchmarks import reach
from benchmarks.bounded_parents import LEAST, LowerBound, estimates, seen
from benchmarks.bounds import RESULTS, table_lines
from benchmarks.reach import Space
from tacevo.parts import Population
from tacevo.results.space_table import read_table

pytestmark = pytest.mark.room("table")


@dataclass(frozen=True)
class Trained:
    """A network that trained, as a part sees it."""

    id: str
    source: str
    fitness: float
    parameters: int = 10
    flops: int = 100
    losses: tuple[float, ...] = ()
    parents: tuple[str, ...] = field(default=())
    curiosity: float = 0.5


def _population(networks: list[Trained]) -> Population:
    """The elite is the one that came first."""
    return Population(generation=3, candidates={one.id: one for one in networks}, elites=networks[:1])


def _layers(count: int, number: int) -> str:
    """Name a layer so many times, in a text of its own."""
    return f"# {number}\n" + "nn.Conv2d(3, 4)\n" * count


def _networks() -> list[Trained]:
    """Make networks up of which each layer halves the loss, with some noise."""
    noise = np.random.default_rng(0).normal(0, 0.1, 40)
    return [Trained(f"g{n:02}", _layers(n % 5, n), math.exp(-math.log(2) * (n % 5) + noise[n])) for n in range(40)]


def test_lucky_network_is_no_parent() -> None:
    """Its own fitness is the lowest of all, but networks like it are bad; a text that comes again counts once."""
    lucky = Trained("g40", _layers(0, 40), 0.05)
    networks = [*_networks(), lucky]
    pool = LowerBound(count=4).pool(_population([*networks, Trained("g41", networks[4].source, 2.0)]))
    assert len({one.source for one in pool}) == 4
    assert all(one.source.count("nn.Conv2d") == 4 for one in pool)


def test_bound_is_lower_where_less_is_known() -> None:
    """A network like no other has the widest estimate, so it becomes a parent by its bound before it does otherwise."""
    networks = [*_networks(), Trained("g40", _layers(3, 40) + "nn.LSTM(3, 4)\n", 0.125)]
    pools = [
        {one.id for one in LowerBound(count=5, deviations=deviations).pool(_population(networks))}
        for deviations in (0.0, 100.0)
    ]
    assert ["g40" in pool for pool in pools] == [False, True]


def test_estimate_is_that_of_a_ridge() -> None:
    """By hand, of one feature with two values: a difference d of n halves shrinks to d n / (n + 1)."""
    expected, deviations = estimates([{"a": 0.0}, {"a": 1.0}] * 5, [1.0, math.e] * 5)
    assert expected == pytest.approx([0.5 - 0.5 * 10 / 11, 0.5 + 0.5 * 10 / 11] * 5)
    left = 10 * (0.5 / 11) ** 2 / (10 - 1 - 10 / 11)
    assert deviations == pytest.approx([math.sqrt(left * (1 / 11 + 1 / 10))] * 10)


def test_elites_are_parents_until_there_is_a_model() -> None:
    """And two of them are drawn at least, which a crossover needs."""
    networks = _networks()[: LEAST - 1]
    assert LowerBound().pool(_population(networks)) == networks[:1]
    with pytest.raises(ValueError, match="count"):
        LowerBound(count=1)
    drawn = LowerBound().draw(networks, 2, np.random.default_rng(0))
    assert len({one.id for one in drawn}) == 2
    assert "parameters" in seen(networks[0])


def test_page_shows_the_searches() -> None:
    """Every row is computed from results/bounds.json and results/reach.json."""
    space = Space(read_table(ROOT / "cache/tables/grating-space.zip"))
    ways, rivals = (json.loads(path.read_text(encoding="utf-8"))["ways"] for path in (RESULTS, reach.RESULTS))
    page = (ROOT / "benchmarks/README.md").read_text(encoding="utf-8")
    assert "\n".join(table_lines(space, ways, rivals)) in page
