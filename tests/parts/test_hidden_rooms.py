"""What moves out can be left out: the core's work is done without it, and what names it is told in one line.

Every room is hidden from import, in every process, by itself and with all others.
"""

import importlib.util
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from checkout import PUBLISHED, ROOT
from rooms import ROOMS, Ended, ask_without, run_without
from smallest import ARCHIVES, Once

from tacevo.parts.facts import OUTPUT_TABLES

ALL = "all at once"

HIDDEN = {**ROOMS, ALL: " ".join(ROOMS.values())}

#: A search on images of a source of the core.
SETTINGS = " ".join(
    [
        *("experiment=demo data=numpy data.root=small.npz data.image_size=16 task.outputs=2 training.epochs=1",),
        *("search.generations=1 search.initial=2 search.candidates=2 tracking=none store.root=store", *ARCHIVES),
    ]
)

STUDY = "elites=1 seeds=2 epochs=1"

#: What the core does, with recorded answers and trainings.
CORE = {
    "help": "--help",
    "search": f"search {SETTINGS} llm.mode=replay run.dir=runs/again",
    "study": f"study runs/again {STUDY}",
    "replay of a run": "replay runs/again",
    "replay of its bundle": "replay run.zip",
    "replay of a published bundle": f"replay {PUBLISHED}/force-variants.zip",
    "tables": "tables runs/again --output tables",
    "show": "show runs/again",
}


def _record(folder: Path) -> None:
    """Record a search with its study and a noise run, and publish it, with all rooms."""
    rng, labels = np.random.default_rng(0), np.arange(120) % 2
    images = rng.integers(0, 60, (120, 16, 16), dtype=np.uint8)
    images[labels == 1, :, 8:] += 120
    np.savez(folder / "small.npz", images=images, labels=labels)
    first = (
        f"search {SETTINGS} run.dir=runs/first",
        f"study runs/first {STUDY}",
        "noise runs/first elites=1 seeds=2",
        "publish runs/first -o run.zip",
    )
    for status, _, said in run_without("", first, folder / "all", folder):
        assert status == 0, said


def _digests(ended: list[Ended]) -> dict[str, list[str]]:
    return {name: re.findall(r"digest: (\w{64})", printed) for name, (_, printed, _) in zip(CORE, ended, strict=True)}


@pytest.fixture(scope="module")
def recorded(once: Once) -> Path:
    """Return a folder with a search, its store and its bundle; no test may change it."""
    return once("hidden_rooms", _record)


@pytest.fixture(scope="module")
def expected(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """Return the digests that the core's work ends in with all rooms."""
    folder = tmp_path_factory.mktemp("whole")
    shutil.copytree(recorded, folder, dirs_exist_ok=True)
    ended = run_without("", list(CORE.values()), folder / "none", folder)
    assert [status for status, _, _ in ended] == [0] * len(CORE)
    digests = _digests(ended)
    assert len({digests[name][-1] for name in ("search", "replay of a run", "replay of its bundle")}) == 1
    assert all(digests[name] for name in ("search", "study", "replay of a published bundle"))
    return digests


@pytest.mark.room(*ROOMS)
def test_rooms_are_there() -> None:
    """A room whose name has changed would hide nothing."""
    for names in ROOMS.values():
        for name in names.split():
            assert importlib.util.find_spec(name) is not None, name


def test_noise_run_that_cannot_be_shown_is_named(recorded: Path, tmp_path: Path) -> None:
    """The summary of the run and what its study found stand there; each noise run is in a line with what is missing."""
    shutil.copytree(recorded, tmp_path, dirs_exist_ok=True)
    ((status, printed, _),) = run_without(HIDDEN["noise"], ["show runs/first"], tmp_path / "hidden", tmp_path)
    (noise,) = (path.name for path in (tmp_path / "runs" / "first" / "studies").glob("noise*"))
    assert status == 0
    assert [line for line in printed.splitlines() if noise in line and "pip install" in line]
    assert [line for line in printed.splitlines() if line.startswith("## elites")]


@pytest.mark.few(2)
@pytest.mark.parametrize("room", [*ROOMS, ALL][::-1])
def test_core_does_its_work_without(room: str, recorded: Path, expected: dict[str, list[str]], tmp_path: Path) -> None:
    """A search with recorded answers, a study, replays, tables: the digests are those with all rooms."""
    shutil.copytree(recorded, tmp_path, dirs_exist_ok=True)
    ended = run_without(HIDDEN[room], list(CORE.values()), tmp_path / "hidden", tmp_path)
    assert {name: status for name, (status, _, _) in zip(CORE, ended, strict=True)} == dict.fromkeys(CORE, 0)
    assert _digests(ended) == expected


#: What names a room, by room.
NAMING = {
    "ray": [f"search {SETTINGS} executor=ray"],
    "mlflow": [f"search {SETTINGS} tracking=mlflow", "track runs/first"],
    "export": ["export runs/first g00s00 --output exported"],
    "hosted": [f"search {SETTINGS} llm=anthropic", f"search {SETTINGS} llm=openai llm.model=mine"],
    "batches": [f"search {SETTINGS} llm=anthropic llm.delivery=batch"],
    "grammar": [f"search {SETTINGS} seed=1"],
    "simulator": ["search experiment=demo tracking=none", "data simulate task=force out=images"],
    "tacverse": ["search experiment=demo data=tacverse data.root=. data.image_size=64 tracking=none"],
    "table": [
        f"search experiment=table data.root={ROOT}/cache/tables/grating-space.zip tracking=none",
        f"replay {ROOT}/cache/tables/grating-space.zip",
        "tabulate experiment=space --output space.zip",
        "judge space.zip --output judged.zip",
    ],
    "page": ["report runs/first --output page.html"],
    "document": ["report runs/first --latex --output paper"],
    "figures": ["figures runs/first", "report runs/first --latex --output paper"],
    "estimate": [f"search {SETTINGS} --estimate"],
    "data check": ["data check task=force"],
    "init": ["init mine", "init my_part --part fitness"],
    "crate": ["publish runs/first -o again.zip"],
    "motifs": ["publish runs/first -o again.zip"],
    "noise": ["noise runs/first", "study runs/first choose=reestimated", "publish runs/first -o again.zip"],
    "surrogate": [f"search {SETTINGS} proposals.skipped=0.5"],
    "Pareto": ["publish runs/first -o again.zip"],
    "alarms": ["publish runs/first -o again.zip"],
    "effects of instructions": ["publish runs/first -o again.zip"],
    "plans, pilots": ["plan study runs/first --effect 0.1 -o plan"],
}


@pytest.mark.few(6)
@pytest.mark.parametrize("room", NAMING)
def test_what_names_a_hidden_room_is_told_in_one_line(room: str, recorded: Path, tmp_path: Path) -> None:
    """The exit status is 2, and the line says which module is missing and how it is installed; nothing is made."""
    shutil.copytree(recorded, tmp_path, dirs_exist_ok=True)
    made = {path for path in tmp_path.iterdir() if path.is_dir()}
    for status, printed, said in run_without(HIDDEN[room], NAMING[room], tmp_path.parent / "hidden", tmp_path):
        *before, line = said.splitlines()
        assert (status, printed) == (2, ""), said
        assert [word for word in (*before, line) if word.startswith(("error", "Traceback"))] == [line]
        assert "pip install" in line
        assert re.search(r"[Nn]o module (named )?'?(tacevo|analysis|ray|onnx|matplotlib|openai|anthropic)", line), line
    assert {path for path in tmp_path.iterdir() if path.is_dir()} <= made | {tmp_path / "runs", tmp_path / "paper"}


#: What names a room from Python, by room; `RUN` is an open run.
FROM_PYTHON = {
    "Pareto": ["RUN.pareto()"],
    "figures": ["RUN.figures", "RUN.studies[0].figures"],
    "plans, pilots": ["tacevo.plan"],
    "noise": ["tacevo.noise(RUN, quiet=True)"],
    "export": ["RUN.export('g00s00', 'exported', quiet=True)"],
    "data check": ["RUN.figures['samples']()", "tacevo.check_data('task=force', quiet=True)"],
    "table": ["tacevo.open_table"],
    "crate": ["tacevo.publish(RUN, 'again.zip', quiet=True)"],
    "surrogate": [f"tacevo.search(*{[*SETTINGS.split(), 'proposals.skipped=0.5']}, quiet=True)"],
}

#: Prints the error that each line raises; an open run has its tables whatever is hidden.
_ASKING = """
import sys
import tacevo
RUN = tacevo.open("runs/first")
assert RUN.tables and RUN.studies[0].tables
for line in sys.stdin.read().splitlines():
    try:
        eval(line)
    except tacevo.ConfigError as error:
        print(error)
"""


@pytest.mark.few(4)
@pytest.mark.parametrize("room", FROM_PYTHON)
def test_what_names_a_hidden_room_from_python_is_told_in_the_same_line(
    room: str, recorded: Path, tmp_path: Path
) -> None:
    """As a ConfigError; what needs it not is there."""
    shutil.copytree(recorded, tmp_path, dirs_exist_ok=True)
    lines = "\n".join(FROM_PYTHON[room])
    told = ask_without(HIDDEN[room], _ASKING, lines, folder=tmp_path / "hidden", cwd=tmp_path).splitlines()
    assert len(told) == len(FROM_PYTHON[room])
    for line in told:
        assert re.search(r"expected what it needs to be installed; got no module (tacevo|analysis|matplotlib)", line)


@pytest.mark.parametrize(("room", "named"), [("noise", "tacevo noise"), ("page", "tacevo report")])
def test_no_command_of_a_hidden_room_is_proposed(room: str, named: str, recorded: Path, tmp_path: Path) -> None:
    """At the end of a search and of a study."""
    shutil.copytree(recorded, tmp_path, dirs_exist_ok=True)
    asked = [CORE["search"], CORE["study"]]
    for hidden, is_proposed in (("", True), (HIDDEN[room], False)):
        printed = "".join(out for _, out, _ in run_without(hidden, asked, tmp_path / "hidden", tmp_path))
        assert (named in printed) == is_proposed


@pytest.mark.parametrize("room", ["motifs", "noise"])
def test_tables_of_a_missing_part_are_missing_and_said(room: str, recorded: Path, tmp_path: Path) -> None:
    """All others are written; and a bundle that holds such tables is EQUAL, but for them, which the replay says."""
    shutil.copytree(recorded, tmp_path, dirs_exist_ok=True)
    (_, _, said), (status, printed, _) = run_without(
        HIDDEN[room], ["tables runs/first --output tables", "replay run.zip"], tmp_path / "hidden", tmp_path
    )
    assert re.search(f"no tables or figures of {room}: .*analysis.tables.{room}", said)
    made = {path.stem for path in (tmp_path / "tables").rglob("*.csv")}
    assert {"gate", "improvement", "scores"} - made == set()
    assert made & set(OUTPUT_TABLES[room]) == set()
    assert status == 0
    assert "of a part that is not installed" in printed


def test_figures_and_page_are_made_without_an_output(recorded: Path, tmp_path: Path) -> None:
    """What they have of it is missing, and said; everything else is there."""
    shutil.copytree(recorded, tmp_path, dirs_exist_ok=True)
    commands = ["figures runs/first --output figures", "report runs/first --output page.html"]
    figures, page = run_without(HIDDEN["Pareto"], commands, tmp_path / "hidden", tmp_path)
    assert (figures[0], page[0]) == (0, 0), figures[2] + page[2]
    assert "no tables or figures of pareto: " in figures[2]
    drawn = {path.stem for path in (tmp_path / "figures").iterdir()}
    assert "fitness" in drawn
    assert "pareto" not in drawn
    assert "no tables or figures of pareto: " in (tmp_path / "page.html").read_text()
