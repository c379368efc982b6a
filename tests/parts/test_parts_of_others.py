"""Whoever installs a package may use its parts by their names, and whoever has not got it can read what they made."""

import json
import re
import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest
from bundles import members_of
from checkout import ROOT
from refusals import refused
from rooms import Ended, run_without
from smallest import ARCHIVES, Once

from analysis.report.outputs import Outputs, outputs
from analysis.report.sweep_collection import SweepCollection, sweep_tables
from analysis.table import Table
from tacevo.api.opening import open as open_run
from tacevo.api.sweeps import Sweep
from tacevo.config.compose import compose
from tacevo.errors import ConfigError
from tacevo.parts.kinds import OUTPUTS, SOURCES
from tacevo.parts.making import Given, made
from tacevo.parts.output import Output
from tacevo.parts.registry import Part, find

LAB = ROOT / "tests/support/lab"

SETTINGS = " ".join(
    [
        "experiment=demo task.outputs=2 data.image_size=16 training.epochs=1 search.generations=1 search.initial=1",
        *("search.candidates=1 store.root=store", *ARCHIVES),
    ]
)

CHOSEN = f"{SETTINGS} data.source=robot llm.provider=echo llm.model=parrot executor.kind=lab tracking.kind=notes"

FILES = f"data.source={LAB}/mylab.py:Robot llm.provider={LAB}/mylab.py:Echo"

FIRST = {
    "search": f"search {CHOSEN} run.dir=run",
    "tables": "tables run --output tables",
    "publish": "publish run --output run.zip",
    "help": "--help",
    "greet": "greet you",
    "file": f"search {SETTINGS} {FILES} llm.model=parrot parts.Robot.touches=30 tracking=none run.dir=by_file",
    "its bundle": "publish by_file --output by_file.zip",
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


def test_advice_names_no_setting_that_a_users_source_lacks(recorded: Path) -> None:
    """`data.images` is one of some of ours."""
    summary = (recorded / "run/summary.md").read_text()
    assert "training.epochs" in summary
    assert "data.images" not in summary


class Arms(Output):
    """Adds a table of a sweep."""

    def sweep_tables(self, sweep: SweepCollection) -> Sequence[Table]:
        """Count the arms."""
        return [Table(name="arms", caption="Arms.", columns=("arms",), rows=((len(sweep.ablation.names),),))]


def test_output_of_a_users_has_tables_of_a_sweep() -> None:
    """Behind all others; those of ours are as in the bundle."""
    known = outputs(ours=True)
    part = Part(kind=OUTPUTS, name="arms", module="mylab", attribute="Arms", origin="mylab 1.0")
    sweep = open_run(ROOT / "examples/lexicase.zip")
    assert isinstance(sweep, Sweep)
    collected = sweep.collection()
    mine = Outputs(known=(*known.known, (part, Arms())), missing={})
    *others, last = sweep_tables(collected, mine)
    assert (last.name, last.rows) == ("arms", ((2,),))
    assert others == list(sweep_tables(collected))


def test_part_in_a_file_is_used_and_its_place_is_published_nowhere(recorded: Path) -> None:
    """Its own settings have the name of its class."""
    run = json.loads((recorded / "by_file/run.json").read_text())
    assert sum(run["data"]["counts"]) == run["config"]["parts"]["Robot"]["touches"] == 30
    members = members_of(recorded / "by_file.zip")
    assert "mylab.py:Robot" in members["run/run.json"].decode()
    assert not [name for name, content in members.items() if str(LAB).encode() in content]


def test_whoever_lacks_the_package_reads_replays_and_compares(recorded: Path, tmp_path: Path) -> None:
    """A run, its bundle and its tables need none of the parts; what needs one says which."""
    shutil.copytree(recorded, tmp_path, dirs_exist_ok=True)
    needless = [
        "show run",
        "tables run --output tables",
        "replay run",
        "replay run.zip",
        "replay by_file",
        "replay by_file.zip",
    ]
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


def test_part_with_settings_in_its_name_is_told_where_they_go() -> None:
    """As a caller of a class would write them."""
    named = f"data.source='{LAB}/mylab.py:Robot(touches=7)'"
    with refused(ConfigError, place="data.source", expected="FILE.py:CLASS", remedy="parts.CLASS.FIELD=VALUE"):
        compose(["experiment=demo", named])


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
