"""Promise: all who search the table meet equal terms, and other seeds than theirs judge what they hand over."""

import json
import math
from collections.abc import Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up import TINY, made_up_table

import tacevo
from benchmarks.judging import Handed, Space, mean
from benchmarks.peers_table import ours
from benchmarks.peers_table.__main__ import PAGE, RESULTS, TABLE, main, row_of
from benchmarks.peers_table.asking import MOST_ASKED, Choices, Genes, Optimiser, Visit, handed_over, visits
from benchmarks.peers_table.by_pyribs import map_elites
from benchmarks.peers_table.figures import REFERENCE, differs, table
from benchmarks.peers_table.plain import POPULATION, draws, regularised_evolution
from tacevo.api.space_problems import SpaceProblem
from tacevo.results.space_table import read_table
from tacevo.results.table_records import SpaceTable

pytestmark = pytest.mark.room("table")

EPOCHS = 4


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> SpaceTable:
    """Make the table of eight networks and the baseline, of which one fails."""
    place = tmp_path_factory.mktemp("peers") / "table.zip"
    return made_up_table(place, *TINY, f"training.epochs={EPOCHS}", failing=3)


@pytest.fixture(scope="module")
def problem(rows: SpaceTable) -> SpaceProblem:
    """Make a problem of it."""
    return tacevo.open_table(rows.path).as_problem()


def every(problem: SpaceProblem, rows: SpaceTable) -> list[dict[str, bool | int | float | str]]:
    """List all networks by their genes."""
    return [dict(network.genome) for network in rows.networks if network.genome is not None]


def asks(listed: list[Genes], told: list[float]) -> Optimiser:
    """Make an optimiser that asks for these again and again, and notes what it is told."""

    def optimiser(choices: Choices, seed: int, trainings: int) -> Generator[Genes, float, None]:
        while True:
            for genes in listed:
                told.append((yield genes))

    return optimiser


def test_network_that_comes_again_is_no_training(problem: SpaceProblem, rows: SpaceTable) -> None:
    """It is remembered with its fitness; who asks for nothing else is stopped."""
    first, second, *_, last = every(problem, rows)
    told: list[float] = []
    found = visits(asks([first, first, second], told), problem, seed=0, trainings=3, epochs=2, failed=9.0)
    assert [visit.genes for visit in found] == [first, second]
    assert len(told) == 3 * MOST_ASKED
    assert set(told) == {visit.fitness for visit in found}
    short = visits(asks([first, last, second], told), problem, seed=0, trainings=2, epochs=2, failed=9.0)
    assert [visit.genes for visit in short] == [first, last]


def test_equal_seeds_meet_equal_noise(problem: SpaceProblem, rows: SpaceTable) -> None:
    """A network has one recorded seed in a search, in whatever order it comes; other searches have others."""
    listed: list[Genes] = [*every(problem, rows)]
    seeds = set()
    for seed in range(20):
        one, other = (
            visits(asks(order, []), problem, seed=seed, trainings=8, epochs=3, failed=9.0)
            for order in (listed, listed[::-1])
        )
        assert one == other[::-1]
        assert [visit.fitness for visit in one] == [
            problem.evaluate(visit.genes, seed=visit.seed, epochs=3).fitness for visit in one
        ]
        seeds.add(tuple(visit.seed for visit in one))
    assert len(seeds) > 10


def test_failed_network_is_told_and_never_handed_over(problem: SpaceProblem, rows: SpaceTable) -> None:
    """An optimiser is told a number, and the search knows better."""
    failed, other = dict(rows.networks[3].genome or {}), dict(rows.networks[4].genome or {})
    told: list[float] = []
    found = visits(asks([failed, other], told), problem, seed=0, trainings=2, epochs=2, failed=0.0)
    assert told == [0.0]
    assert found[0].fitness == math.inf
    assert handed_over(found, 2).genes == other


def test_fittest_within_the_budget_is_handed_over() -> None:
    """No later network counts; of equally fit ones the first is taken."""
    found = [Visit({"a": number}, 0, fitness) for number, fitness in enumerate([0.5, 0.4, 0.4, 0.1])]
    assert [handed_over(found, trainings).genes["a"] for trainings in (1, 2, 3, 9)] == [0, 1, 1, 3]


def test_what_is_handed_over_is_judged_by_other_seeds(problem: SpaceProblem, rows: SpaceTable) -> None:
    """A network is found in the table by its genes, in whatever order they come."""
    listed = every(problem, rows)
    for genes in listed:
        row = row_of(rows, dict(reversed(genes.items())))
        for seed in range(problem.seeds):
            judged = mean(Space(rows), [Handed(row, (seed,))] * 2).value
            assert judged == pytest.approx(problem.judge(genes, seen=[seed]))
    assert len(listed) == 8


@pytest.mark.parametrize("optimiser", [draws, regularised_evolution, map_elites])
def test_optimiser_asks_for_networks_of_the_space(problem: SpaceProblem, optimiser: Optimiser) -> None:
    """Which answers nothing else; equal seeds ask alike, others do not."""
    found, again = (visits(optimiser, problem, seed=5, trainings=8, epochs=2, failed=9.0) for _ in range(2))
    assert found == again
    assert len(found) > 4
    assert found != visits(optimiser, problem, seed=6, trainings=8, epochs=2, failed=9.0)


def test_evolution_changes_one_gene_of_one_that_lives() -> None:
    """And prefers the fitter ones."""
    choices = {"a": tuple(range(50)), "b": tuple(range(50)), "c": (1,)}
    asking = regularised_evolution(choices, 0, 100)
    living = [next(asking)]
    for _ in range(100):
        fitness = living[-1]["a"]
        assert isinstance(fitness, int)
        living.append(asking.send(fitness))
    for at in range(POPULATION, 100):
        apart = [sum(living[at][gene] != each[gene] for gene in choices) for each in living[at - POPULATION : at]]
        assert 1 in apart
    ends = [np.mean([each["a"] for each in part]) for part in (living[:POPULATION], living[-POPULATION:])]
    assert ends[1] < ends[0]


def test_search_of_ours_is_of_this_table(problem: SpaceProblem, rows: SpaceTable) -> None:
    """Its trainings are recorded ones, each network once; its baseline is judged as a network of the space."""
    found = ours.visits(rows, seed=1, answers=26, epochs=2, settings=("archive.niches=5", "archive.prompt_niches=5"))
    assert len(found) > 4
    for visit in found[1:]:
        assert visit.fitness == problem.evaluate(visit.genes, seed=visit.seed, epochs=2).fitness
    keys = [tuple(visit.genes.values()) for visit in found[1:]]
    assert len(set(keys)) == len(keys)
    assert handed_over(found, 4).fitness < math.inf
    assert row_of(rows, handed_over(found[:1], 4).genes) > 0


def _measured(searches: dict[str, list[int]]) -> dict[str, Any]:
    """Write what searches handed over, by the rows of networks: each after both budgets, seen by the first seed."""
    found = {name: {"searches": [[[row, 0]] * 2 for row in networks]} for name, networks in searches.items()}
    return {"date": "today", "libraries": {"ribs": "1"}, "epochs": 10, "budgets": [5, 9], "contenders": found}


def test_table_tells_searches_apart_that_differ(rows: SpaceTable) -> None:
    """The best comes first; who hands over the worst network is behind draws, who hands over what they do is not."""
    space = Space(rows)
    losses = {row: mean(space, [Handed(row, (0,))] * 2).value for row in range(len(rows.networks))}
    low, *_, high = sorted((row for row, loss in losses.items() if math.isfinite(loss)), key=lambda row: losses[row])
    searches = {REFERENCE: [low] * 50, "same": [low] * 50, "worse": [high] * 50, "begun": [low]}
    measured = _measured(searches)
    told = differs(space, {name: measured["contenders"][name] for name in (REFERENCE, "same", "worse")}, 2)
    lines = [*table(space, measured)]
    first, *_, last = lines[4:]
    assert told == {("worse", 0), ("worse", 1)}
    assert last.count("\\*") == 2
    assert f"**{math.exp(losses[low]):.3f} [" in first
    assert last.startswith(f"| worse | 50 | {math.exp(losses[high]):.3f}")
    assert not any(line.startswith("| begun") for line in lines)


def test_network_that_failed_tells_nothing_apart(rows: SpaceTable) -> None:
    """Who hands it over has an infinite loss, and no error of it is known."""
    measured = _measured({REFERENCE: [1] * 5, "failed": [3] * 5})
    lines = [*table(Space(rows), measured)]
    assert lines[-1].startswith("| failed | 5 | inf")
    assert "\\*" not in lines[-1]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--searches", "1"], "--searches"),
        (["--searches", "0"], "--searches"),
        (["--searches", "-3"], "--searches"),
        (["--only", "unknown"], "--only"),
        (["--only", "random draws", "SMAC4"], "SMAC4"),
    ],
)
def test_arguments_are_checked_before_anything_is_opened(
    given: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Too few searches for an interval, and contenders that nobody knows; neither table nor results are looked at."""
    with pytest.raises(SystemExit) as ended:
        main(["--table", str(tmp_path / "none.zip"), "--results", str(tmp_path / "results.json"), *given])
    assert ended.value.code == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_table_without_a_row_is_its_head(rows: SpaceTable) -> None:
    """Of contenders with one search each, or none, there is no interval."""
    assert len([*table(Space(rows), _measured({REFERENCE: [1], "begun": []}))]) == 4


def test_page_shows_what_was_handed_over() -> None:
    """Every figure is computed from results/peers-table.json, by the judge of today's table."""
    measured = json.loads(RESULTS.read_text(encoding="utf-8"))
    page = PAGE.read_text(encoding="utf-8")
    assert "\n".join(table(Space(read_table(TABLE)), measured)) in page
