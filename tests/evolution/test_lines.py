"""The ledger's lines are records: what was published comes back byte for byte, and nothing else is read."""

import json
import zipfile
from pathlib import Path
from typing import Any

import pytest
from checkout import GOLDEN, PUBLISHED
from refusals import refused

from tacevo.errors import RunError
from tacevo.evolution.lines import CandidateLine, GenerationLine
from tacevo.evolution.run_files import line_kind
from tacevo.records import Operator, written
from tacevo.storage.ledger import read_line, read_lines, seal

LEDGER = GOLDEN / "ledger.jsonl"


@pytest.mark.few(3)
@pytest.mark.parametrize("bundle", sorted(PUBLISHED.glob("*.zip")), ids=lambda path: path.stem)
def test_published_lines_are_written_as_they_were(bundle: Path) -> None:
    """A line that was read has the hash that it had, so no digest can change."""
    with zipfile.ZipFile(bundle) as members:
        for name in members.namelist():
            if name.endswith("ledger.jsonl"):
                for text in members.read(name).splitlines():
                    line, previous, own = read_line(text, line_kind, name)
                    assert seal(written(line), previous)[0] == json.loads(text)
                    assert own == json.loads(text)["hash"]


def test_a_ledger_comes_back_as_records() -> None:
    """A reader asks for fields by name; what a line leaves out is at its default."""
    recorded = read_lines(LEDGER, line_kind)
    first = next(line for line in recorded.lines if isinstance(line, CandidateLine))
    assert (first.operator, first.dropped, first.repairs) == (Operator.baseline, (), ())
    assert isinstance(recorded.lines[-1], GenerationLine)
    assert recorded.digest == json.loads(LEDGER.read_bytes().splitlines()[-1])["hash"]


@pytest.mark.parametrize(
    ("changes", "place", "expected"),
    [
        ({"kind": "verdict"}, "line 1", "a line of a known kind"),
        ({"kind": ["candidate"]}, "line 1", "a line of a known kind"),
        ({"slot": "0"}, "line 1, slot", "an integer"),
        ({"fitness": 1e999}, "line 1, fitness", "finite number"),
        ({"mood": "good"}, "line 1, mood", "only keys of this version"),
        ({"dropped": []}, "line 1", "a line that matches its hash"),
    ],
)
def test_a_line_that_no_search_writes_is_rejected(
    changes: dict[str, Any], place: str, expected: str, tmp_path: Path
) -> None:
    """A right hash does not help a line with a field that is missing, unknown, of another type or at its default."""
    recorded = read_lines(LEDGER, line_kind)
    entry = {**written(next(line for line in recorded.lines if isinstance(line, CandidateLine))), **changes}
    text = json.dumps(entry if "fitness" in changes else seal(entry, "0" * 64)[0])
    (tmp_path / "ledger.jsonl").write_text(text + "\n", encoding="utf-8")
    with refused(RunError, place=place, expected=expected):
        read_lines(tmp_path / "ledger.jsonl", line_kind)
