"""Promise: what is sealed is what a reader accepts, who computes no more than the ledger's lines can be of."""

from dataclasses import replace
from typing import Any

import pytest
from hand_runs import configured, of_lines
from ledger_lines import ended, header, trained
from refusals import refused

from tacevo.bundles.format import sealed
from tacevo.bundles.verify import check_sizes, table_difference
from tacevo.errors import RunError
from tacevo.evolution.run_files import Line
from tacevo.results.run import RecordedRun


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
    return of_lines(header(), *lines, config=configured(search=search, **groups))


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


@pytest.mark.parametrize(
    ("recorded", "made", "named"),
    [
        (b"a,1\r\nb,2\r\n", b"a,1\r\nb,2\r\n", None),
        (b"a,1\r\nb,2\r\n", b"a,1\r\nb,3\r\n", "line 2: recorded 'b,2\\r', replayed 'b,3\\r'"),
        (b"a", b"a\n", "recorded 1 lines, replayed 2"),
        (b"\xff", b"\xfe", "its bytes are not UTF-8"),
    ],
)
def test_first_difference_of_tables_is_named(recorded: bytes, made: bytes, named: str | None) -> None:
    """By line, or lengths where all else is equal."""
    assert table_difference(recorded, made) == named
