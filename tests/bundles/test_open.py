"""Promise: a run is opened wherever it lies, and what was unpacked for that is gone at the end."""

import shutil
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from refusals import refused
from sweeps import SHARED, begin

from tacevo.bundles.open import Opened, located, opened, private_folder
from tacevo.errors import DivergenceError, RunError
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.sweep_directory import Job, SweepDirectory, SweepRecord
from tacevo.sweeps.plan import plan
from tacevo.sweeps.status import Standing, status_of


def test_folder_is_opened_where_it_lies(published: Path) -> None:
    """With the stores that its run.json names; nothing is copied."""
    with opened(published / "run") as found:
        assert (found.folder, found.store) == (published / "run", published / "cache")
        assert (found.root, found.digest) == (None, None)


def test_bundle_is_opened_under_the_name_of_its_run(published: Path) -> None:
    """A directory of the run's own name, stores beside it, and neither afterwards."""
    with opened(published / "run.zip") as found:
        assert found.folder.name == "run"
        assert (found.folder / "ledger.jsonl").read_bytes() == (published / "run" / "ledger.jsonl").read_bytes()
        assert any(found.store.glob("completions/*/*.json"))
        assert found.root is not None
        assert (found.root.stat().st_mode & 0o777) == 0o700
    assert not found.root.exists()


def test_what_is_no_run_is_refused(tmp_path: Path) -> None:
    """Neither a directory of something else nor a name of nothing."""
    with refused(RunError, expected="the directory of a run"), opened(tmp_path):
        pass
    with refused(RunError, got="does not exist"), opened(tmp_path / "missing"):
        pass


@pytest.fixture
def failed_once(tmp_path: Path) -> tuple[SweepDirectory, Job]:
    """Return a sweep of one job, finished, whose failure of an earlier time still stands there."""
    directory = SweepDirectory(tmp_path / "sweep")
    job = plan(SHARED, [("ablation=none", "seed=0")])[0].job
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


def fail_within(place: Path, error: type[BaseException], made: list[Path]) -> None:
    """Fail over a file in the private directory that stands for a place, and say where that was."""
    with private_folder(place) as folder:
        made.append(folder)
        raise error(f"{folder}/run/a.json differs")


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_private_folder_is_gone_after_an_error(error: type[BaseException], tmp_path: Path) -> None:
    """Whatever ended the work."""
    made: list[Path] = []
    with pytest.raises(error, match="differs"):
        fail_within(tmp_path, error, made)
    assert not made[0].exists()


def test_private_folder_lies_where_tmpdir_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever names a place has a reason."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    with private_folder(tmp_path / "x.zip") as folder:
        assert folder.parent == tmp_path


@pytest.mark.parametrize(("free", "parent"), [(5 * 1024**3, "/dev/shm"), (3 * 1024**3, "/tmp")])
def test_private_folder_lies_in_memory_where_that_has_room(
    free: int, parent: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two bundles unpack to 4 GiB at most."""
    monkeypatch.delenv("TMPDIR", raising=False)
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=free))
    with private_folder(tmp_path / "x.zip") as folder:
        assert folder.parent == Path(parent)


def test_errors_name_the_place_that_the_folder_stands_for(tmp_path: Path) -> None:
    """A user never sees the temporary directory."""
    made: list[Path] = []
    with pytest.raises(DivergenceError, match=rf"^{tmp_path}/x\.zip/run/a\.json differs$"):
        fail_within(tmp_path / "x.zip", DivergenceError, made)
    assert not made[0].exists()


def fail_over(bundle: Path, told: Callable[[Opened], tuple[str, str]]) -> None:
    """Open a bundle, and fail with a place and a text in which its private directory stands."""
    with opened(bundle) as found:
        place, got = told(found)
        raise RunError(got, place=place)


@pytest.mark.parametrize(
    ("told", "place", "got"),
    [
        (lambda found: (f"{found.folder}/run.json", f"{found.folder}"), ", run/run.json", ", run"),
        (
            lambda found: (f"{found.store}/probes", f"{found.store} is"),
            ", store.jsonl.xz, probes",
            ", store.jsonl.xz is",
        ),
        (lambda found: (f"{found.root}/store.jsonl.xz, line 2", f"{found.root} "), ", store.jsonl.xz, line 2", " "),
    ],
)
def test_errors_name_members_as_the_file_has_them(
    told: Callable[[Opened], tuple[str, str]], place: str, got: str, published: Path
) -> None:
    """Not as `FILE.zip/JOB`, which is the spelling of a sweep's run."""
    bundle = published / "run.zip"
    with refused(RunError, place=f"{bundle}{place}", got=f"{bundle}{got}"):
        fail_over(bundle, told)


def test_errors_name_members_of_a_sweep(swept: Path) -> None:
    """Each job's directory lies in that of the sweep."""
    with refused(RunError, place=f"{swept / 'sweep.zip'}, sweep/none-seed0/run.json"):
        fail_over(swept / "sweep.zip", lambda found: (f"{found.runs[0]}/run.json", ""))


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
