"""A run directory tells of one run, its own, and a replay finds whatever was changed in it."""

import json
import shutil
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
from ledger_lines import run_record
from smallest import SMALLEST, UNTRACKED

from tacevo.cli.app import main
from tacevo.cli.edge import Terminated
from tacevo.config.compose import compose
from tacevo.config.task_texts import load_task
from tacevo.errors import RunError, telling
from tacevo.evolution.run_files import read_ledger
from tacevo.records import written
from tacevo.runs.datasets import load_data
from tacevo.runs.progress import Progress
from tacevo.runs.session import ConfinementLog, record
from tacevo.sandbox.confinement import available, in_force
from tacevo.storage.run_directory import RunDirectory

#: A real search, as small as one can be; with slips, so that answers are rejected, too.
TINY = [
    *SMALLEST,
    UNTRACKED,
    "search.generations=1",
    "search.candidates=4",
    "search.initial=2",
    "llm.slip_rate=0.7",
    "run.dir=run",
]


#: What `published` asks for: with its stores, nothing is trained.
RECORDED = ["search", *SMALLEST, UNTRACKED, "search.generations=0", "search.candidates=3", "search.initial=2"]


@pytest.mark.slow
def test_interrupt_says_that_something_is_kept_once_it_is(place: Path) -> None:
    """Not before the first candidate is in the ledger; from then on also where it comes before the next one.

    SIGTERM is told in the same words; other errors pass as they are.
    """

    def stop(*_: object) -> NoReturn:
        raise KeyboardInterrupt

    config = compose(TINY)
    data = load_data(config, Progress())
    task = load_task(config, data.facts)
    with pytest.raises(KeyboardInterrupt) as before:
        record(config, task, data, Progress(), run=stop)
    assert main(["search", *TINY, "search.generations=0"]) == 0
    with pytest.raises(KeyboardInterrupt) as after:
        record(config, task, data, Progress(), run=stop)
    with pytest.raises(Terminated) as terminated, telling(lambda: True):
        raise Terminated
    assert str(before.value) != str(after.value) == str(terminated.value) != ""
    with pytest.raises(RunError) as damaged, telling(lambda: True):
        raise RunError("damaged")
    assert damaged.value.got == "damaged"


@pytest.mark.slow
def test_description_left_by_a_run_that_decided_nothing_is_replaced(place: Path) -> None:
    """Killed before its first ledger line, another run leaves no part of its description behind."""
    assert main(["search", *TINY, "task=hardness", "search.generations=0"]) == 0
    (place / "run" / "ledger.jsonl").write_text("")
    assert main(["search", *TINY]) == 0
    assert main(["replay", "run"]) == 0


def confinement(run: Path) -> Any:
    """Read what a run directory says of the walls around its candidates."""
    return json.loads((run / "run.json").read_text())["confinement"]


@pytest.mark.slow
def test_walls_are_those_that_held_the_candidates(place: Path) -> None:
    """Nothing is claimed for a run whose candidates were all recalled, and nothing twice for one that is repeated."""
    assert main(["search", *TINY, "search.generations=0"]) == 0
    (first,) = confinement(place / "run")
    assert first["level"] == available()
    assert main(["search", *TINY, "search.generations=0"]) == 0
    assert confinement(place / "run") == [first]
    shutil.rmtree(place / "run")
    assert main(["search", *TINY, "search.generations=0"]) == 0
    assert confinement(place / "run") == []


@pytest.mark.parametrize("before", [[], [{"level": "kernel"}]], ids=["new", "continued"])
def test_candidates_on_a_gpu_are_not_said_to_be_walled(before: Any, place: Path) -> None:
    """What was left out is not claimed, earlier candidates keep theirs, and the machine's own count for nobody."""
    directory = RunDirectory(place)
    directory.write_run(run_record(confinement=tuple(before)))
    log, unwalled = ConfinementLog(directory), in_force(("no_new_privs", "not_dumpable", "no_capabilities"))
    log.note(unwalled)
    log.note(unwalled)
    assert confinement(place) == [*before, unwalled]
    assert (unwalled["level"], "not in force" in unwalled["rlimits"]) == ("none", True)


def test_no_password_reaches_a_run_directory(published: Path, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A run directory is there to be shared: addresses in it hold no user info."""
    shutil.copytree(published / "cache", place / "cache")
    secret = "llm.base_url='http://me:hunter2@localhost'"
    assert main([*RECORDED, "run.dir=run", secret]) == 0
    texts = [path.read_text() for path in (place / "run").rglob("*") if path.is_file()]
    assert not [text for text in texts if "hunter2" in text]
    assert main(["search", *TINY, "tracking.uri='postgresql://me:hunter2@localhost/db'", "run.dir=other"]) == 2
    assert "tracking.uri: expected an address without a password" in capsys.readouterr().err
    assert not (place / "other").exists()


def test_every_kept_file_is_compared(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An edited source and an edited rejected answer are both found, by the candidate's id."""
    rejected = sorted((copied / "run" / "candidates").glob("*.rejected.txt"))
    admitted = sorted((copied / "run" / "candidates").glob("*.py"))
    assert rejected
    for path in (rejected[0], admitted[-1]):
        text = path.read_text()
        path.write_text(text + "# edited\n")
        assert main(["replay", "run"]) == 1
        assert path.name.partition(".")[0] in capsys.readouterr().err
        path.write_text(text)
    assert main(["replay", "run"]) == 0


def test_changed_image_cache_is_refused(published: Path, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The fingerprint in the ledger is that of the images that are trained on, every time."""
    shutil.copytree(published / "cache", place / "cache")
    (images,) = (place / "cache" / "data").glob("*/images.npy")
    data = bytearray(images.read_bytes())
    data[-1] ^= 1
    images.write_bytes(data)
    assert main(RECORDED) == 2
    assert "was changed or damaged; delete that directory" in capsys.readouterr().err


def test_selection_never_sees_the_test_images(place: Path) -> None:
    """Two data sets that differ in all test images and labels give one search, but for what names the data."""
    rng = np.random.default_rng(0)
    images, labels = rng.integers(0, 256, (40, 16, 16, 3), dtype=np.uint8), rng.random((40, 3))
    np.savez("a.npz", images=images, labels=labels, names=["Fx", "Fy", "Fz"])
    usual = [setting for setting in RECORDED[1:] if not setting.startswith("data.")]
    numpy = [*usual, "data=numpy", "data.image_size=16", "archive.niches=5"]
    rows = load_data(compose([*numpy, "data.root=a.npz"]), Progress()).test
    images[rows], labels[rows] = 255 - images[rows], labels[rows] + 1
    np.savez("b.npz", images=images, labels=labels, names=["Fx", "Fy", "Fz"])
    decisions = []
    for name in ("a", "b"):
        assert main(["search", *numpy, f"data.root={name}.npz", f"run.dir={name}"]) == 0
        header: Any
        header, *lines = map(written, read_ledger(RunDirectory(place / name)).lines)
        del header["data"]["fingerprint"]
        decisions.append([header["data"], *({**line, "evaluation": None} for line in lines)])  # its key holds it, too
    first, second = (json.loads((place / name / "run.json").read_text())["data"] for name in ("a", "b"))
    assert first["fingerprint"] != second["fingerprint"]
    assert len(rows) == 4
    assert decisions[0] == decisions[1]
    assert (place / "a" / "archive.json").read_text() == (place / "b" / "archive.json").read_text()
