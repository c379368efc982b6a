"""`tacevo parts` lists what there is without importing it, and `check` tells which promises a part breaks."""

import re
import shutil
from pathlib import Path

import pytest
from checkout import ROOT
from commands import tacevo
from refusals import refused
from rooms import run_without

from tacevo.errors import ConfigError
from tacevo.parts.kinds import KINDS, SOURCES
from tacevo.parts.registry import find, import_file

LAB = ROOT / "tests/support/lab"

HONEST = ROOT / "tests/support/deciding/honest.py"


def test_list_has_every_part_and_imports_none(tmp_path: Path) -> None:
    """Of a package that offers a name of ours, or of another package, the list says that it is not used."""
    shutil.copytree(LAB, tmp_path / "lab")
    with (tmp_path / "lab/mylab.py").open("a") as module:
        module.write("open('imported', 'w')\n")
    other = tmp_path / "other/otherlab-2.0.dist-info"
    other.mkdir(parents=True)
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: otherlab\nVersion: 2.0\n")
    (other / "entry_points.txt").write_text("[tacevo.providers]\necho = otherlab:Echo\n")
    installed = [tmp_path / "lab", tmp_path / "other"]
    ((status, printed, _),) = run_without("", ["parts"], tmp_path / "none", tmp_path, installed=installed)
    assert status == 0
    for kind in KINDS.values():
        for name in kind.ours:
            assert re.search(rf"^  {name} +tacevo +\S", printed, re.MULTILINE), name
    assert re.search(r"^  robot +mylab 1.0 +Two kinds of touch", printed, re.MULTILINE)
    assert re.search(r"^  csv +mylab 1.0 +never used", printed, re.MULTILINE)
    assert len(re.findall(r"^  echo +(?:mylab 1.0|otherlab 2.0) +not used", printed, re.MULTILINE)) == 2
    assert not re.search(r"settings of `|Make (the|what)", printed)
    assert not (tmp_path / "imported").exists()


def test_list_says_what_is_not_installed(tmp_path: Path) -> None:
    """Of a part of ours whose library comes with an extra."""
    ((_, printed, said),) = run_without("openai", ["parts providers"], tmp_path / "hidden", tmp_path)
    assert re.search(r"^  openai +tacevo +needs openai", printed, re.MULTILINE), said
    assert "parents" not in printed


@pytest.mark.parametrize(
    ("words", "status"),
    [
        ([f"{HONEST}:Greedy", "parts.Greedy.k=3"], 0),
        ([f"{LAB}/mylab.py:Robot", "data.image_size=16", "task=grating"], 0),
        (["temperature.rule=paper"], 0),
        (["stall"], 0),
        ([f"{HONEST}:Greedy", "parts.Greedy.k=three"], 1),
        (["uniform"], 2),
        (["unifrom"], 2),
        (["nothing.py"], 2),
        ([f"{HONEST}:ranked"], 2),
        ([f"{HONEST}:Gredy"], 2),
        ([f"{HONEST}:Greedy", "data.imags=3"], 2),
        ([], 2),
    ],
)
def test_check_ends_with_the_status_of_what_it_found(tmp_path: Path, words: list[str], status: int) -> None:
    """0 where all is kept, 1 where a promise is broken, 2 where the user made a mistake."""
    done = tacevo("parts", "check", *words, cwd=tmp_path, status=status)
    assert ("made with k=3, margin=0.0" in done.stdout) == ("parts.Greedy.k=3" in words)
    assert ("BROKEN" in done.stdout) == (status == 1)
    assert ("kept" in done.stdout) == (status == 0)


def test_check_of_a_file_checks_all_parts_in_it(tmp_path: Path) -> None:
    """A line for each promise of each; one that is broken is told, and the others are tried all the same."""
    text = HONEST.read_text().replace("return min(losses) / 2", "return float('nan')")
    (tmp_path / "mine.py").write_text(text)
    (tmp_path / "neighbour.py").write_text((HONEST.parent / "neighbour.py").read_text())
    done = tacevo("parts", "check", "mine.py", cwd=tmp_path, status=1).stdout
    for name in ("Greedy", "Last", "Falling", "Half", "Size", "Rows"):
        assert f"mine.py:{name}" in done
    (broken, *_) = [line for line in done.splitlines() if "BROKEN" in line]
    assert "finite" in broken


@pytest.mark.parametrize(
    ("text", "got"),
    [
        ("class Mine(:", "SyntaxError"),
        ("x = 1 / 0", "ZeroDivisionError: division by zero, mine.py, line 1"),
        ("x = None.y", "AttributeError"),
        ("from tacevo.parts import Nothing", "Nothing"),
        ("import no_such_library", "no module no_such_library"),
        ("class Mime: pass", "Mine"),
    ],
)
def test_file_that_cannot_be_imported_is_told_in_one_line(tmp_path: Path, text: str, got: str) -> None:
    """Whatever its module raises."""
    (tmp_path / "mine.py").write_text(text)
    with refused(ConfigError, place="data.source=Mine", got=got):
        find(SOURCES, f"{tmp_path}/mine.py:Mine").load()


def test_file_may_have_a_neighbour_and_annotations_that_are_texts(tmp_path: Path) -> None:
    """As any module: a dataclass looks its types up, and what lies beside it can be imported."""
    (tmp_path / "beside.py").write_text("SIZE = 3\n")
    (tmp_path / "mine.py").write_text(
        "from __future__ import annotations\nfrom dataclasses import dataclass\nfrom beside import SIZE\n"
        "@dataclass(frozen=True)\nclass Mine:\n    size: int = SIZE\n"
    )
    assert import_file(tmp_path / "mine.py").Mine().size == 3
