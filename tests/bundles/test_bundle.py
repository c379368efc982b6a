"""Promise: what is sealed is what a reader accepts, who computes no more than the ledger's lines can be of."""

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hand_runs import configured
from ledger_lines import ended, header, rejected, run_record, trained
from refusals import refused

from tacevo.bundles.format import sealed
from tacevo.bundles.verify import check_sizes, table_difference
from tacevo.errors import RunError
from tacevo.evolution.files import Line
from tacevo.evolution.lines import SeedLine
from tacevo.results.run import RecordedRun
from tacevo.rules import FIRST
from tacevo.storage.ledger import Sealed
from tacevo.storage.run_directory import RunDirectory


@pytest.mark.parametrize(
    "name",
    [
        "tables/größe.csv",
        "tables/a b.csv",
        "notes.txt",
        "run/candidates/x.py",
        "../x",
        "sweep/a b/run.json",
        "sweep/sweep.json/run.json",
    ],
)
def test_strange_member_is_not_published(name: str) -> None:
    """What no reader would accept is not written."""
    with refused(RunError, expected="names with the letters", got=repr(name)):
        sealed({name: b""})


def sized(*lines: Line, **groups: dict[str, Any]) -> RecordedRun:
    """Make a run of its lines alone, whose generations may have one candidate after the baseline."""
    search = {"generations": 1, "candidates": 1, "initial": 0} | groups.pop("search", {})
    run = RunDirectory(Path("nowhere"))
    ledger: Sealed[Line] = Sealed(lines=(header(), *lines))
    return RecordedRun(
        directory=run, record=run_record(), config=configured(search=search, **groups), ledger=ledger, rules=FIRST
    )


def test_bound_that_was_not_reached_excuses_no_missing_generation() -> None:
    """The replay would plan as many slots as run.json says; one that the ledger's lines reach ends the run there."""
    begun = trained("g00s00", 0.5), ended(0)
    spent = 384 * begun[0].flops  # type: ignore[operator]
    check_sizes(sized(*begun, search={"training_flops": float(spent)}))
    with refused(RunError, expected="1000003 lines", got="3"):
        check_sizes(sized(*begun, search={"training_flops": 2.0 * spent, "candidates": 10**6 - 1}))
    whole = *begun, trained("g01s00", 0.5), ended(1)
    check_sizes(sized(*whole, search={"training_flops": 2.0 * spent}))
    below = replace(ended(0), generation=-1)  # a generation below 0 would take lines away
    with refused(RunError, expected="lines"):
        check_sizes(sized(*begun[:1], below, search={"training_flops": 1.0, "candidates": 10**6, "initial": 10**6}))


@pytest.mark.parametrize(("seeds", "named", "fits"), [(1, 0, True), (3, 3, True), (3, 0, False), (1, 3, False)])
def test_every_training_of_a_network_stands_in_its_line(seeds: int, named: int, fits: bool) -> None:
    """So a replay recalls no more trainings than the ledger holds; nor does a ledger in which nothing trained."""
    one = SeedLine(seed=0, evaluation="e", train_losses=(), validation_losses=(), predictions="p", weights="w")
    line = trained("g00s00", 0.5, seeds=(one,) * named)
    training = {"seeds": seeds}
    with contextlib.nullcontext() if fits else refused(RunError, expected=f"{seeds} in every line"):
        check_sizes(sized(line, ended(0), search={"generations": 0}, training=training))
    with refused(RunError, expected=f"{seeds} in every line"):
        failed = rejected("g00s00", "train", "not_finite")
        check_sizes(sized(failed, ended(0), search={"generations": 0}, training=training))


def test_first_difference_of_tables() -> None:
    """Cells by row and column, names by their place, other files by line, lengths where all else is equal."""
    table = b"name,value\r\na,1\r\nb,2\r\n"
    assert table_difference(table, table, is_csv=True) is None
    assert (
        table_difference(table, table.replace(b"2", b"3"), is_csv=True)
        == "row 2, column 'value': recorded '2', replayed '3'"
    )
    assert (
        table_difference(table, table.replace(b"name", b"x"), is_csv=True)
        == "name of column 1: recorded 'name', replayed 'x'"
    )
    assert table_difference(table, table + b"c,3\r\n", is_csv=True) == "line 4: recorded '', replayed 'c,3\\r'"
    broken = table.replace(b"a,1", b'"a"x,1')
    assert table_difference(broken, table, is_csv=True) == "line 2: recorded '\"a\"x,1\\r', replayed 'a,1\\r'"
    assert table_difference(b"a\n", b"b\n", is_csv=False) == "line 1: recorded 'a', replayed 'b'"
    assert table_difference(b"a", b"a\n", is_csv=False) == "recorded 1 lines, replayed 2"
    assert table_difference(b"\xff", b"\xfe", is_csv=False) == "its bytes are not UTF-8"
