"""Whoever installs a package may use its parts by their names, and whoever has not got it can read what they made."""

import re
import shutil
from pathlib import Path

import pytest
from checkout import ROOT
from refusals import refused
from rooms import Ended, run_without
from smallest import ARCHIVES, Once

from tacevo.config.compose import compose
from tacevo.errors import ConfigError
from tacevo.parts.kinds import SOURCES
from tacevo.parts.making import Given, made
from tacevo.parts.registry import find

LAB = ROOT / "tests/support/lab"

SETTINGS = " ".join(
    [
        "experiment=demo task.outputs=2 data.image_size=16 training.epochs=1 search.generations=1 search.initial=1",
        *("search.candidates=1 store.root=store", *ARCHIVES),
    ]
)

CHOSEN = f"{SETTINGS} data.source=robot llm.provider=echo llm.model=parrot executor.kind=lab tracking.kind=notes"

FIRST = {
    "search": f"search {CHOSEN} run.dir=run",
    "tables": "tables run --output tables",
    "publish": "publish run --output run.zip",
    "help": "--help",
    "greet": "greet you",
    "file": f"search {SETTINGS} data.source={LAB}/mylab.py:Robot llm=grammar tracking=none run.dir=by_file",
}


def _named(commands: dict[str, str], ended: list[Ended]) -> dict[str, Ended]:
    return dict(zip(commands, ended, strict=True))


def _record(folder: Path) -> None:
    ended = run_without("", list(FIRST.values()), folder / "hidden", folder, installed=[LAB])
    for name, (status, printed, said) in _named(FIRST, ended).items():
        assert status == 0, (name, said)
        (folder / f"{name}.out").write_text(printed + said, encoding="utf-8")


@pytest.fixture(scope="module")
def recorded(once: Once) -> Path:
    """Return a folder with what the parts of a package made; no test may change it."""
    return once("parts_of_others", _record)


def test_parts_of_a_package_are_used_by_name(recorded: Path) -> None:
    """A source, a provider, an executor, a tracker, a table and a command; a source also from a file."""
    search = (recorded / "search.out").read_text()
    assert "the lab runs 2 candidates at once" in search
    assert "notes: notes.txt" in search
    assert (recorded / "notes.txt").read_text() == "run\n"
    assert "2 of 2 first answers trained" in search
    assert (recorded / "tables/more/widths.csv").read_text() == "candidates\n3\n"
    assert re.search("^parts:\n  greet +of mylab 1.0$", (recorded / "help.out").read_text(), re.MULTILINE)
    assert "hello, you" in (recorded / "greet.out").read_text()
    assert (recorded / "by_file/ledger.jsonl").exists()


def test_whoever_lacks_the_package_reads_replays_and_compares(recorded: Path, tmp_path: Path) -> None:
    """A run, its bundle and its tables need none of the parts; what needs one says which."""
    shutil.copytree(recorded, tmp_path, dirs_exist_ok=True)
    needless = ["show run", "tables run --output tables", "replay run", "replay run.zip", "replay by_file"]
    for status, _, said in run_without("", needless, tmp_path / "hidden", tmp_path):
        assert status == 0, said
    needing = {
        "robot": ["replay run --retrain 1", "study run elites=1 seeds=2"],
        "mylab.py": [f"search {SETTINGS} data.source=lost/mylab.py:Robot tracking=none"],
        "echo": [f"search {SETTINGS} llm.provider=echo tracking=none"],
        "lab": [f"search {SETTINGS} executor.kind=lab tracking=none"],
        "notes": [f"search {SETTINGS} tracking.kind=notes"],
    }
    for name, commands in needing.items():
        for status, _, said in run_without("", commands, tmp_path / "hidden", tmp_path):
            *_, last = said.splitlines()
            assert status == 2, said
            assert last.startswith("error: ")
            assert name in last


@pytest.mark.parametrize(
    ("setting", "close"),
    [("data.source=folde", "folder"), ("llm.provider=gramar", "grammar"), ("executor.kind=locl", "local")],
)
def test_unknown_part_is_answered_with_the_nearest(setting: str, close: str) -> None:
    """At composition, with all names that there are."""
    with refused(ConfigError, place=setting.partition("=")[0], expected=f"{close}", remedy=f"did you mean {close}?"):
        compose(["experiment=demo", setting])


def _given(**own: object) -> Given:
    settings = {"source": "robot", "root": None, "image_size": 32}
    return Given(group="data", settings=settings, own=own, task="force", root=Path())  # type: ignore[arg-type]


def test_fields_of_a_part_are_its_settings() -> None:
    """Those of its group come from there, all others are its own, and each is checked by its type."""
    part = find(SOURCES, f"{LAB}/mylab.py:Robot")
    source = made(part, _given(touches=7))
    assert (source.image_size, source.touches) == (32, 7)
    with refused(ConfigError, place="parts.Robot.touches", expected="an integer", got='"many"'):
        made(part, _given(touches="many"))
    with refused(ConfigError, place="parts.Robot.toches", expected="one of touches", remedy="did you mean touches?"):
        made(part, _given(toches=7))
