"""Promise: who follows docs/parts.md has a part that works, and its tables are those of the code."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from checkout import ROOT
from commands import tacevo
from presupposed import write_logs
from test_docs_commands import write_files_of

from tacevo.parts.kinds import KINDS, Kind
from tacevo.parts.protocols import ALLOWED

PAGE = ROOT / "docs" / "parts.md"

TEXT = PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", KINDS.values(), ids=lambda kind: kind.name)
def test_kind_has_its_row(kind: Kind) -> None:
    """With its setting, its class, whether it decides, and the names of ours."""
    (row,) = re.findall(rf"^\| {kind.name} \| (.+) \|$", TEXT.partition("## Settings")[0], re.MULTILINE)
    setting, written, decides, names = row.split(" | ")
    assert kind.setting in setting
    assert (f"tacevo.parts.{kind.base}`" in written) == bool(kind.base)
    assert decides.startswith("yes") == kind.decides
    if kind.name != "commands":
        assert re.findall("`(.+?)`", names) == list(kind.ours)


def test_allowed_imports_are_listed() -> None:
    """All of them, but `__future__`, which is no library."""
    (listed,) = re.findall(r"import its own modules and these: (.+?)\. Random", TEXT, re.DOTALL)
    assert set(re.findall("`(.+?)`", listed)) == ALLOWED - {"__future__"}


@pytest.mark.parametrize(
    "words", [["parts/mine.py", "parts.Fittest.k=3"], ["parts/logs.py", "data.root=LOGS", "data.image_size=32"]]
)
def test_part_of_the_page_keeps_its_contracts(tmp_path: Path, words: list[str]) -> None:
    """As a reader copies it."""
    write_files_of(PAGE, tmp_path)
    write_logs(tmp_path / "LOGS")
    assert "BROKEN" not in tacevo("parts", "check", *words, cwd=tmp_path).stdout


def test_test_of_the_page_passes(tmp_path: Path) -> None:
    """By pytest, beside the part."""
    write_files_of(PAGE, tmp_path)
    (test,) = re.findall(r"^```python\n(import pytest\n.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)
    (tmp_path / "parts/test_mine.py").write_text(test, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "parts/test_mine.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    assert "6 passed" in done.stdout
