"""Promise: what was finished before is neither told as trained nor waited for again."""

from pathlib import Path

import pytest
from interruptions import SEARCH

from tacevo.cli.app import main

#: A tracker that writes down whether it was waited for.
TRACKER = """
from dataclasses import dataclass
from pathlib import Path

@dataclass(frozen=True)
class Patient:
    def mirror(self, runs):
        return self

    def finish(self, timeout):
        with Path("waited.txt").open("a") as file:
            file.write(f"{timeout > 1}\\n")

    def viewing(self):
        return ""
"""


def test_nobody_waits_for_the_mirror_of_a_finished_run(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Called again it adds nothing; continued, it has lines that a mirror is waited for, and only these are told."""
    (copied / "tracker.py").write_text(TRACKER)
    again = ["search", *SEARCH, "tracking.kind=tracker.py:Patient"]
    assert main(again) == 0
    assert "finished before; nothing to do" in capsys.readouterr().err
    assert main([*again, "search.generations=3"]) == 0
    told = capsys.readouterr().err
    assert "finished after" in told
    assert "nothing to do" not in told
    generations = [line for line in told.splitlines() if line.endswith("candidates done)")]
    assert [line.split(":")[0] for line in generations] == ["generation 3"]
    assert Path("waited.txt").read_text().split() == ["False", "True"]


def test_stopped_run_tells_what_was_recorded_before(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its generations were not trained now, and are not told as if they were."""
    ledger = copied / "run" / "ledger.jsonl"
    lines = ledger.read_text().splitlines(keepends=True)
    ledger.write_text("".join(lines[:-1]))
    assert main(["search", *SEARCH, "tracking=none"]) == 0
    told = [line for line in capsys.readouterr().err.splitlines() if line.endswith("candidates done)")]
    assert ["as recorded" in line for line in told] == [True] * (len(told) - 1) + [False]
