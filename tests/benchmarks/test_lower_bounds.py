"""Promise: parents by a lower bound are those that a model expects to be good, however lucky others were."""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from checkout import ROOT

from benchmarks import reach
from benchmarks.bounded_parents import LEAST, LowerBound, estimates, seen
from benchmarks.bounds import RESULTS, table_lines
from benchmarks.judging import Space
from benchmarks.reach import searched
from tacevo.config.compose import compose
from tacevo.parts import Population
from tacevo.results.run import read_run
from tacevo.results.space_table import read_table
from tacevo.runs.progress import Progress
from tacevo.runs.session import search

pytestmark = pytest.mark.room("table")


@pytest.fixture(scope="module")
def space() -> Space:
    """Read the table that comes with the project."""
    return Space(read_table(ROOT / "cache/tables/grating-space.zip"))


@dataclass(frozen=True)
class Trained:
    """A network that trained, as a part sees it."""

    id: str
    source: str
    fitness: float
    parameters: int = 10
    flops: int = 100
    losses: tuple[float, ...] = ()
    parents: tuple[str, ...] = ()
    curiosity: float = 0.5


def _population(networks: list[Trained]) -> Population:
    """The elite is the one that came first."""
    return Population(generation=3, candidates={one.id: one for one in networks}, elites=networks[:1])


def _layers(count: int, number: int) -> str:
    """Name a layer so many times, in a text of its own."""
    return f"# {number}\n" + "nn.Conv2d(3, 4)\n" * count


def _networks() -> list[Trained]:
    """Make networks up. Each further layer halves the loss; there is some noise."""
    noise = np.random.default_rng(0).normal(0, 0.1, 40)
    return [Trained(f"g{n:02}", _layers(n % 5, n), math.exp(-math.log(2) * (n % 5) + noise[n])) for n in range(40)]


def test_lucky_network_is_no_parent() -> None:
    """Its own fitness is the lowest of all, but networks like it are bad. One that failed is none, either."""
    networks = [*_networks(), Trained("g40", _layers(0, 40), 0.05), Trained("g41", _layers(4, 41), math.inf)]
    pool = LowerBound(count=4).pool(_population(networks))
    assert len(pool) == 4
    assert all(one.source.count("nn.Conv2d") == 4 for one in pool)
    assert "g41" not in {one.id for one in LowerBound(count=40).pool(_population(networks))}


def test_network_that_comes_again_is_one_parent() -> None:
    """Whether its text differs or not: two that are exactly as fit are one, or it could be crossed with itself."""
    networks = _networks()
    again = [Trained(f"h{one.id}", f"{one.source}# again", one.fitness) for one in networks]
    pool = LowerBound(count=8).pool(_population([*networks, *again]))
    assert len({one.fitness for one in pool}) == len(pool) == 8
    assert all(one in networks for one in pool)


def test_bound_is_lower_where_less_is_known() -> None:
    """A network like no other has the widest estimate, so it becomes a parent by its bound before it does otherwise."""
    networks = [*_networks(), Trained("g40", _layers(3, 40) + "nn.LSTM(3, 4)\n", 0.125)]
    pools = [
        {one.id for one in LowerBound(count=5, deviations=deviations).pool(_population(networks))}
        for deviations in (0.0, 100.0)
    ]
    assert ["g40" in pool for pool in pools] == [False, True]


def test_estimate_is_that_of_a_ridge() -> None:
    """By hand: of n networks half have each of two values, and the ridge multiplies their difference by n / (n + 1)."""
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


def test_search_takes_these_parents(place: Path, space: Space) -> None:
    """From the file, in processes of their own; `benchmarks.bounds` asks them in one process, and they decide alike."""
    part = f"proposals.parents={ROOT / 'benchmarks/bounded_parents.py'}:LowerBound"
    given = [f"data.root={space.table.path}", f"store.root={place / 'cache'}", "training.epochs=10"]
    end = ["search.generations=5", f"run.dir={place / 'run'}", "tracking=none", "seed=3"]
    search(compose(["experiment=table", *given, part, *end]), Progress())
    trained = dict.fromkeys(space.rows[str(line.source)] for line in read_run(place / "run").trained)
    ours, published = (
        [visit.network for visit in searched(space, 3, len(trained), given, parents)]
        for parents in (LowerBound(), None)
    )
    assert [*trained] == ours
    assert ours[:LEAST] == published[:LEAST]
    assert ours != published


def test_page_shows_the_searches(space: Space) -> None:
    """Every row is computed from results/bounds.json and results/reach.json."""
    ways, rivals = (json.loads(path.read_text(encoding="utf-8"))["ways"] for path in (RESULTS, reach.RESULTS))
    page = (ROOT / "benchmarks/README.md").read_text(encoding="utf-8")
    assert "\n".join(table_lines(space, ways, rivals)) in page
