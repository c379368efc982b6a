"""Promise: a command reads each file of a run once."""

import os
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from tacevo.cli.app import main

#: Counts the files that are opened for reading, while it is one.
_COUNTED: list[Counter[str]] = []


def _count(event: str, arguments: tuple[object, ...]) -> None:
    """Python calls this at every event of its audit."""
    if not _COUNTED or event != "open":
        return
    path, mode, _ = arguments
    if isinstance(path, (str, os.PathLike)) and "r" in str(mode):
        _COUNTED[-1][os.fspath(path)] += 1


@pytest.fixture(scope="module", autouse=True)
def _audited() -> None:
    """Python keeps a hook until it ends."""
    sys.addaudithook(_count)


@pytest.fixture
def reads() -> Iterator[Counter[str]]:
    """Count what is read while a test runs."""
    _COUNTED.append(Counter())
    yield _COUNTED[-1]
    _COUNTED.pop()


@pytest.mark.parametrize(
    "command",
    [
        "replay",
        "tables",
        "show",
        pytest.param("report", marks=pytest.mark.room("page")),
        pytest.param("figures", marks=[pytest.mark.slow, pytest.mark.room("figures")]),
    ],
)
def test_each_file_of_a_run_is_read_once(command: str, run: Path, reads: Counter[str]) -> None:
    """Records, candidates' files and studies: what was read and checked is handed on, and not read again."""
    own = {os.fspath(path) for path in run.rglob("*") if path.is_file()}
    assert main([command, str(run)]) == 0
    several = {path: number for path, number in reads.items() if path in own and number > 1}
    assert several == {}
    assert {f"{run}/run.json", f"{run}/ledger.jsonl", f"{run}/archive.json"} <= reads.keys()
