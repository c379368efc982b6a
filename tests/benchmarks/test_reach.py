"""Promise: a way to search hands over once what its budget found, and is judged by seeds that it has not seen."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from checkout import ROOT
from made_up import TINY, made_up_judge, made_up_table

from benchmarks.judging import Handed, Space, Visit, mean
from benchmarks.reach import (
    BUDGETS,
    RESULTS,
    at_random,
    handed_over,
    reach,
    searched,
    table,
)
from tacevo.config.compose import compose
from tacevo.results.run import read_run
from tacevo.results.space_table import read_table
from tacevo.runs.progress import Progress
from tacevo.runs.session import search

pytestmark = pytest.mark.room("table")


@pytest.fixture
def space(place: Path) -> Space:
    """Return a space with three seeds."""
    return Space(made_up_table(place / "table.zip", *TINY, "training.epochs=10"))


def test_fittest_network_that_the_budget_pays_for_is_handed_over() -> None:
    """Later trainings count for larger budgets alone, whatever they found; of equally fit ones the first is taken."""
    losses = [0.5, 0.4, 0.4, 0.9, 0.9, 0.1]
    visits = [Visit(network, loss, network % 3) for network, loss in enumerate(losses)]
    assert handed_over(visits, 10, (10, 50, 60, 400)) == [
        Handed(0, (0,)),
        Handed(1, (1,)),
        Handed(5, (2,)),
        Handed(5, (2,)),
    ]
    assert handed_over(visits, 5, (10, 15)) == [Handed(1, (1,)), Handed(1, (1,))]


def test_network_that_failed_is_not_handed_over(place: Path) -> None:
    """Even if it came first."""
    failing = Space(made_up_table(place / "table.zip", *TINY, "training.epochs=10", failing=3))
    visits = [failing.visit(row, 0, 10) for row in (3, 4)]
    assert handed_over(visits, 10, (20,)) == [Handed(4, (0,))]
    assert np.isinf(mean(failing, [Handed(3, (0,))] * 2).value)


def test_seed_that_chose_does_not_judge(space: Space) -> None:
    """Whatever its test loss is; the mean is of logarithms."""
    expected = float(np.log(space.tests[3, [0, 2]]).mean())
    handed = [Handed(3, (1,)), Handed(3, (1,))]
    assert mean(space, handed).value == pytest.approx(expected, abs=1e-8)
    assert mean(space, handed, handed).value == 0


def test_many_searches_do_not_make_two_judges_more(space: Space) -> None:
    """The error of one network that all searches hand over stays that of its judges."""
    few, many = (mean(space, [Handed(3, (1,))] * count) for count in (10, 1000))
    assert few.error == pytest.approx(many.error)
    assert few.error > 0
    assert mean(space, [Handed(3, (1,))] * 10, [Handed(3, (1,))] * 10).error == pytest.approx(
        0, abs=1e-9
    )  # they share both


def test_error_is_of_whatever_judges(place: Path) -> None:
    """By hand: the fresh seeds of the networks that the table's judge has, and the recorded ones of the others."""
    bare = made_up_table(place / "bare.zip", *TINY, "training.epochs=10")
    judged = Space(made_up_judge(place / "judged.zip", bare, networks=2, seeds=4))
    assert judged.table.judge is not None
    (first, losses), *_ = judged.table.judge.test_losses.items()
    logs = np.log(losses)
    one = mean(judged, [Handed(first, (1,))] * 5)
    assert one.value == pytest.approx(logs.mean(), abs=1e-8)
    assert one.error == pytest.approx(np.sqrt(logs.var(ddof=1) / 4))
    assert mean(judged, [Handed(first, (0,))] * 5) == one  # a recorded seed is none of the judge's
    other = next(row for row in range(1, 9) if row not in judged.table.judge.test_losses)
    both = mean(judged, [Handed(first, (1,))] * 5, [Handed(other, (1,))] * 5)
    noise = (logs.var(ddof=1) + np.log(judged.tests[other]).var(ddof=1)) / 2
    assert both.error == pytest.approx(np.sqrt(noise * (1 / 4 + 1 / 2)))


def test_way_without_an_error_has_no_row(space: Space) -> None:
    """With no search, with one, or without draws of as long trainings: no other number depends on it."""
    handed = {row: [[row, 0]] * len(BUDGETS) for row in range(1, 6)}
    ways: dict[str, Any] = {
        "draws, 10 epochs": {"epochs": 10, "searches": [handed[1], handed[2], handed[3]]},
        "ours": {"epochs": 10, "searches": [handed[3], handed[4], handed[5]]},
    }
    plain = table(space, ways)
    few = {"none": {"epochs": 10, "searches": []}, "one": {"epochs": 10, "searches": [handed[1]]}}
    assert table(space, {**ways, **few}) == plain
    assert "nan" not in plain
    alone = table(space, {**ways, "short": {**ways["ours"], "epochs": 5}, **few})
    assert alone.split("\n\n")[1] == plain.split("\n\n")[1]
    assert "| short | 3 |" in alone
    alike = {
        name: {"epochs": 10, "searches": [handed[1]] * count} for name, count in (("draws, 10 epochs", 3), ("b", 7))
    }
    assert table(space, alike).count("| 1.000 [1.000, 1.000] | 1 | 1 | 1 |") == len(BUDGETS)
    assert "none" not in table(space, few)


def test_file_of_other_budgets_is_refused(space: Space, tmp_path: Path) -> None:
    """Its searches handed over at other times; nothing is searched, and the file stays."""
    file = tmp_path / "reach.json"
    for budgets in ([50, 100, 200], [*BUDGETS, 800], [5, 10, 20, 40]):
        file.write_text(json.dumps({"table": space.table.digest, "budgets": budgets, "ways": {}}), encoding="utf-8")
        before = file.read_bytes()
        with pytest.raises(SystemExit, match="budgets"):
            reach(space, file, 1, 0)
        assert file.read_bytes() == before


def test_random_networks_are_distinct(space: Space) -> None:
    """Their losses are those of one seed of the table."""
    visits = at_random(space, 0, 4, 5)
    assert len({visit.network for visit in visits}) == 4
    assert all(visit.loss == space.lowest[visit.network, visit.seed, 4] for visit in visits)
    assert visits != at_random(space, 1, 4, 5)


@pytest.mark.room("surrogate")
def test_ours_searches_as_the_command_does(tmp_path: Path) -> None:
    """The same networks in the same order, with the same losses, as a run of `experiment=table` records them."""
    shipped = Space(read_table(ROOT / "cache/tables/grating-space.zip"))
    place = [f"data.root={shipped.table.path}", f"store.root={tmp_path / 'cache'}", f"run.dir={tmp_path / 'run'}"]
    settings = ["training.epochs=5", "proposals.skipped=0.5"]
    config = compose(["experiment=table", "tracking=none", "seed=3", "search.generations=6", *place, *settings])
    search(config, Progress())
    recorded: dict[int, float] = {}
    for line in read_run(tmp_path / "run").trained:
        assert line.validation_losses is not None
        recorded.setdefault(shipped.rows[str(line.source)], min(line.validation_losses))
    ours = searched(shipped, 3, len(recorded), [*place[1:2], *settings])
    assert [(visit.network, visit.loss) for visit in ours] == list(recorded.items())


def test_page_shows_what_was_searched() -> None:
    """Every row of both tables is that of results/reach.json, as it is judged now."""
    recorded = json.loads(RESULTS.read_text(encoding="utf-8"))
    shipped = Space(read_table(ROOT / "cache/tables/grating-space.zip"))
    assert (recorded["table"], tuple(recorded["budgets"])) == (shipped.table.digest, BUDGETS)
    levels, compared = table(shipped, recorded["ways"]).split("\n\n")
    pages = {name: (ROOT / name).read_text(encoding="utf-8") for name in ("benchmarks/README.md", "docs/table.md")}
    assert all(levels in page for page in pages.values())
    assert compared in pages["benchmarks/README.md"]
