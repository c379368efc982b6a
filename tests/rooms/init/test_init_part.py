"""Promise: `tacevo init NAME --part KIND` writes a part that works at once, with a test that passes."""

import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from checkout import ROOT
from commands import tacevo
from full_disks import largest_file
from refusals import refused
from rooms import run_without

from tacevo.cli.app import main
from tacevo.cli.new_part import run_init_part
from tacevo.config.compose import compose
from tacevo.errors import ConfigError
from tacevo.parts.kinds import COMMANDS, KINDS, OUTPUTS, Kind

PACKAGED = (OUTPUTS, COMMANDS)

IN_FILES = [kind for kind in KINDS.values() if kind not in PACKAGED]


@pytest.fixture
def place(place: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty directory to stand in."""
    monkeypatch.chdir(place)
    return place


def written(kind: Kind, capsys: pytest.CaptureFixture[str], whose: str = "my") -> dict[str, list[str]]:
    """Write `my_KIND`; return the printed commands, without `tacevo` and the like, by the words before them."""
    assert main(["init", f"{whose}_{kind.name}", "--part", kind.name]) == 0
    lines = capsys.readouterr().out.splitlines()
    return {line.split(":")[0]: shlex.split(line.partition(":")[2])[1:] for line in lines}


def passes(tests: str, place: Path) -> bool:
    """Answer whether pytest passes what is there."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", tests],
        cwd=place,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode == 0 and re.search(r"\d passed", done.stdout) is not None


@pytest.mark.room("grammar", "simulator")
def test_parts_in_files_work_at_once(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A part of each kind keeps the contracts, its test passes, and the printed search composes with it."""
    commands = {kind: written(kind, capsys) for kind in IN_FILES}
    verified = run_without("", [shlex.join(each["verify"]) for each in commands.values()], place / "none", place)
    assert [status for status, _, _ in verified] == [0] * len(IN_FILES), verified
    assert {each["test"][0] for each in commands.values()} == {str(file) for file in Path("parts").glob("test_*.py")}
    assert passes("parts", place)
    for kind, each in commands.items():
        assert f"My{kind.name.capitalize()}" in str(compose(each["try"][1:]))


@pytest.mark.parametrize("kind", PACKAGED, ids=lambda kind: kind.name)
def test_part_of_a_package_works_where_it_is_installed(
    kind: Kind, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its test passes, and its entry point leads to what keeps the contracts."""
    commands = written(kind, capsys)
    assert passes(commands["test"][0], place)
    package = place / commands["add"][-1]
    project = tomllib.loads((package / "pyproject.toml").read_text())["project"]
    ((group, (entry,)),) = ((group, points.items()) for group, points in project["entry-points"].items())
    record = package / "mine-0.1.dist-info"
    record.mkdir()
    (record / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 0.1\n")
    (record / "entry_points.txt").write_text(f"[{group}]\n{' = '.join(entry)}\n")
    ((status, printed, said),) = run_without(
        "", [shlex.join(commands["verify"])], place / "none", place, installed=[package]
    )
    assert status == 0, said
    assert "kept" in printed


@pytest.mark.room("grammar", "simulator")
def test_search_with_a_written_part_is_replayed(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As any other; the parts of all kinds that decide, in one search."""
    deciding = [kind for kind in KINDS.values() if kind.decides]
    words = [written(kind, capsys, "our")["try"][2] for kind in deciding]
    small = ["search.generations=1", "search.initial=2", "search.candidates=2", "training.epochs=1", "data.images=100"]
    few = ["archive.niches=5", "archive.samples=100", "tracking=none", "run.dir=run", "store.root=store"]
    tacevo("search", "experiment=demo", *words, *small, *few, cwd=place)
    assert "EQUAL" in tacevo("replay", "run", cwd=place).stdout


@pytest.mark.parametrize(
    ("name", "kind", "of"),
    [
        ("Width", "descriptors", "NAME"),
        ("my-width", "descriptors", "NAME"),
        ("width_", "outputs", "NAME"),
        ("class", "fitness", "NAME"),
        ("none", "fitness", "NAME"),
        ("", "fitness", "NAME"),
        ("../width", "fitness", "NAME"),
        ("json", "fitness", "NAME"),
        ("numpy", "sources", "NAME"),
        ("parents", "parents", "NAME"),
        ("generation", "temperatures", "NAME"),
        ("show", "commands", "NAME"),
        ("parser", "commands", "NAME"),
        ("pareto", "outputs", "NAME"),
        ("width", "descriptorz", "--part"),
        ("width", "", "--part"),
    ],
)
def test_name_that_cannot_be_one_is_refused(name: str, kind: str, of: str, place: Path) -> None:
    """Nothing is written: the name of a module that is there, of what the part itself needs, or of one of ours."""
    with refused(ConfigError, place=of):
        run_init_part(name, kind)
    assert list(place.iterdir()) == []


@pytest.mark.parametrize("taken", ["parts/width.py", "parts/test_width.py", "parts"])
def test_what_is_there_is_not_changed(taken: str, place: Path) -> None:
    """Neither file is written where one of them, or what is no directory, is in the way."""
    (place / taken).parent.mkdir(exist_ok=True)
    (place / taken).write_text("mine")
    with refused(ConfigError):
        run_init_part("width", "descriptors")
    assert [path.read_text() for path in place.rglob("*") if path.is_file()] == ["mine"]


def test_part_is_whole_or_absent(place: Path) -> None:
    """On a full disk nothing is left, not even a new directory."""
    with largest_file(300), refused(ConfigError, place="parts/width"):
        run_init_part("width", "outputs")
    assert list(place.iterdir()) == []


def test_part_is_no_task(place: Path) -> None:
    """Options of a task do not go with it."""
    assert main(["init", "width", "--part", "fitness", "--like", "force"]) == 2
    assert list(place.iterdir()) == []
