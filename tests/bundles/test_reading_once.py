"""Promise: a command that reads a whole run walks each chain of hashes once."""

from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from tacevo.cli.app import main
from tacevo.storage.ledger import read_lines


@pytest.fixture
def walked(monkeypatch: pytest.MonkeyPatch) -> Counter[Path]:
    """Return how often each ledger and each study's scores are read from now on."""
    times: Counter[Path] = Counter()

    def counted(path: Path, *others: Any) -> object:
        times[path] += 1
        return read_lines(path, *others)

    for module in ("tacevo.evolution.run_files", "tacevo.results.study_directory"):
        monkeypatch.setattr(f"{module}.read_lines", counted)
    return times


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "command",
    [
        ["replay", "run"],
        ["replay", "run.zip"],
        ["publish", "run", "-o", "again.zip"],
        ["tables", "run", "-o", "again"],
    ],
)
def test_each_chain_is_walked_once(command: list[str], published: Path, place: Path, walked: Counter[Path]) -> None:
    """That of the search, and that of its study; what is published is a copy, which is read for itself."""
    name, run, *others = command
    assert main([name, str(published / run), *others]) == 0
    assert {path.name for path in walked} == {"ledger.jsonl", "scores.jsonl"}
    assert set(walked.values()) == {1}
