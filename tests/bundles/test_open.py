"""Promise: a run is opened wherever it lies, and nothing is unpacked for that."""

import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from refusals import refused
from sweeps import SHARED, begin

from tacevo.bundles.open import located, opened
from tacevo.errors import CacheMissError, RunError
from tacevo.records import Mode
from tacevo.results.sweep import Standing
from tacevo.storage.files import write_durably
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.store import Store, read_entry
from tacevo.storage.sweep_directory import Job, SweepDirectory, SweepRecord
from tacevo.sweeps.status import status_of
from tacevo.sweeps.sweeping import plan


def test_bundle_is_opened_under_the_name_of_its_run(published: Path) -> None:
    """With the run's own name, and the entries of its stores; a directory where it lies, with those of its run.json.

    Errors name members as the file has them, and what is not a member's name is the name of nothing.
    """
    folder, place = opened(published / "run"), opened(published / "run.zip")
    assert (folder.folder, folder.store) == (published / "run", published / "cache")
    assert (folder.root, folder.digest) == (None, None)
    assert place.folder.name == "run"
    assert (place.folder / "ledger.jsonl").read_bytes() == (published / "run" / "ledger.jsonl").read_bytes()
    assert f"{place.folder / 'run.json'}" == f"{published}/run.zip, run/run.json"
    with refused(CacheMissError, place=f"{published}/run.zip, store.jsonl.xz, probes"):
        Store(place.store, "probes", Mode.replay).find("of another run")
    for name in ("..", "../run", "/etc/passwd", "candidates/../../run", "missing", "run.json/x"):
        assert not (place.folder / name).exists()
    completion = next(place.store.glob("completions/*/*.json"))
    assert read_entry(completion) == read_entry(next((published / "cache").rglob(completion.name)))


@pytest.mark.parametrize(
    "touch",
    [
        lambda path: path.write_text("x"),
        lambda path: path.open("ab"),
        lambda path: path.unlink(),
        lambda path: list(path.rglob("*")),
        lambda path: (path / "x").mkdir(),
        lambda path: write_durably(path, "x"),
        lambda path: shutil.copytree(path, "there"),
    ],
)
def test_bundle_is_only_read(touch: Callable[[Path], object], published: Path, place: Path) -> None:
    """Whatever else a path can do, no member leads to the disk."""
    bundle = opened(published / "run.zip")
    with pytest.raises(TypeError, match="member of a bundle"):
        touch(bundle.folder)
    assert list(place.iterdir()) == []


#: Prints what a command writes or makes on the disk.
WATCHED = """
import os, sys
told = []
def hook(event, args):
    writes = event == "open" and isinstance(args[2], int) and args[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
    if (writes and args[0] != os.devnull) or event in {"os.mkdir", "os.symlink", "os.link", "os.rename"}:
        told.append(str(args[0]))
sys.addaudithook(hook)
from tacevo.cli.app import main
status = main(sys.argv[1:])
print(status, told)
"""


@pytest.mark.few(1)
@pytest.mark.parametrize("command", [["replay", "run.zip"], ["show", "run.zip", "g00s00"], ["replay", "sweep.zip"]])
def test_reading_a_bundle_writes_nothing(command: list[str], published: Path, swept: Path, place: Path) -> None:
    """No member and no store entry is unpacked, wherever that would be."""
    name, file, *more = command
    whole = str((published if file == "run.zip" else swept) / file)
    done = subprocess.run(
        [sys.executable, "-B", "-c", WATCHED, name, whole, *more], check=True, capture_output=True, text=True
    )
    assert done.stdout.splitlines()[-1] == "0 []"
    assert list(place.iterdir()) == []


@pytest.fixture
def failed_once(tmp_path: Path) -> tuple[SweepDirectory, Job]:
    """Return a sweep of one job, finished, whose failure of an earlier time still stands there."""
    directory = SweepDirectory(tmp_path / "sweep")
    (job,) = plan(SHARED, [("ablation=none", "seed=0")])
    begin(directory, job)
    directory.fail(job, "the disk is full")
    directory.write(SweepRecord(overrides=tuple(SHARED), jobs=(job,)))
    return directory, job


def test_finished_job_is_finished_whatever_failed_before(failed_once: tuple[SweepDirectory, Job]) -> None:
    """Its watchman may have been killed, or somebody finished it by hand; every reader of sweeps agrees."""
    directory, job = failed_once
    assert located(directory.path).jobs == ("none-seed0",)
    assert status_of(directory, job).standing is Standing.finished


def test_job_whose_ledger_lost_its_end_is_not_finished(failed_once: tuple[SweepDirectory, Job]) -> None:
    """A digest alone finishes nothing."""
    directory, job = failed_once
    ledger = directory.run(job).ledger
    ledger.write_bytes(b"".join(ledger.read_bytes().splitlines(keepends=True)[:-1]))
    with refused(RunError, got="none-seed0 (failed: the disk is full)", remedy="`tacevo search -m` command"):
        located(directory.path)


def test_what_is_no_run_is_refused(tmp_path: Path) -> None:
    """Neither a directory of something else nor a name of nothing."""
    for path, fields in (
        (tmp_path, {"expected": "the directory of a run"}),
        (tmp_path / "x", {"got": "does not exist"}),
    ):
        with refused(RunError, **fields):
            opened(path)


@pytest.mark.parametrize("of", ["published", "swept"])
def test_unpacked_bundle_is_told_what_to_name(of: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    """By every reader of a run's or a sweep's directory."""
    (bundle,) = request.getfixturevalue(of).glob("*.zip")
    with zipfile.ZipFile(bundle) as archive:
        archive.extractall(tmp_path)
    named = f"or {tmp_path}/run, whose stores" if of == "published" else "candidates of a sweep are in its store"
    for read in (located, lambda path: RunDirectory(path).read_run(), lambda path: SweepDirectory(path).read()):
        with refused(RunError, place=str(tmp_path), remedy="name the file that `tacevo publish` wrote") as told:
            read(tmp_path)
        assert named in told.value.remedy
