"""All runs below a folder come into MLflow, each once; what is damaged is named, and only ids are written there."""

import json
import os
import shutil
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mirrored import BASELINE, ENTRIES, build_run, build_sweep, everything
from mounts import read_only

from tacevo.cli.app import main
from tacevo.errors import RunError
from tacevo.storage.files import alone
from tacevo.storage.run_directory import RunDirectory
from tacevo.tracking.backfill import find_runs, track
from tacevo.tracking.identity import FILE

# MLflow uses a loader option of SQLAlchemy that its newest version deprecates.
pytestmark = pytest.mark.filterwarnings("ignore:The ``noload`` loader strategy is deprecated")

#: Seconds after which a process is taken for stuck; machines are busy.
PATIENCE = 300


def quietly(done: int, total: int) -> None:
    """Show nothing."""


def files_below(folder: Path) -> dict[Path, bytes]:
    """Give every file below a folder, with what it holds."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_runs_are_found_at_any_depth_by_name(tmp_path: Path) -> None:
    """A run's own folders are not searched, nor are hidden ones, nor what a link points to."""
    for name in ("b", "a/deep", ".hidden", "b/studies/inner"):
        build_run(tmp_path / name, ENTRIES[:1])
    (tmp_path / "again").symlink_to(tmp_path / "b")
    errors: list[OSError] = []
    assert find_runs(tmp_path, errors.append) == (tmp_path / "a" / "deep", tmp_path / "b")
    assert find_runs(tmp_path / "b", errors.append) == (tmp_path / "b",)
    assert errors == []


@pytest.mark.parametrize("name", ["empty", "missing"])
def test_folder_without_a_run_is_the_users_mistake(name: str, tmp_path: Path) -> None:
    """A mistyped folder is told of."""
    (tmp_path / "empty").mkdir()
    with pytest.raises(RunError, match=r"neither the folder of a run .* nor holds one"):
        find_runs(tmp_path / name, lambda error: None)


def test_damaged_run_is_named_and_the_others_are_written(
    tmp_path: Path, uri: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Status 1, a line for each damaged run, nothing of these in MLflow, and of no run is more written than an id."""
    runs = tmp_path / "runs"
    for name in ("a", "edited", "lost", "z"):
        build_run(runs / name, ENTRIES)
    ledger = runs / "edited" / "ledger.jsonl"
    ledger.write_text(ledger.read_text(encoding="utf-8").replace("0.25", "0.125", 1), encoding="utf-8")
    (runs / "lost" / "run.json").unlink()
    before = files_below(runs)
    assert main(["track", str(runs), "--uri", uri]) == 1
    out, errors = capsys.readouterr()
    assert "2 runs of" in out
    edited, lost = errors.splitlines()
    assert "edited/ledger.jsonl, line 2 does not match its hash" in edited
    assert "it has no run.json" in lost
    assert {path[0] for path in everything(uri)} == {"a", "z"}
    written = files_below(runs)
    assert written.keys() - before.keys() == {runs / name / FILE for name in ("a", "z")}
    assert written | before == written


def test_each_run_that_names_no_store_is_told_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is guessed."""
    build_run(tmp_path / "runs" / "a", ENTRIES[:1])
    assert main(["track", str(tmp_path / "runs")]) == 1
    assert "give --uri" in capsys.readouterr().err


def test_tracking_a_folder_twice_changes_nothing(tmp_path: Path, uri: str) -> None:
    """A sweep and a run beside it, begun and finished jobs: the second time finds all of it."""
    build_sweep(tmp_path / "runs" / "sweep", ENTRIES)
    build_run(tmp_path / "runs" / "sweep" / "none-seed1", ENTRIES[:3], whole=False)
    build_run(tmp_path / "runs" / "alone", ENTRIES)
    assert len(track(tmp_path / "runs", uri, quietly).done) == 4
    first = everything(uri)
    assert first["sweep", "none-seed1"][1] == "KILLED"
    assert len(track(tmp_path / "runs", uri, quietly).done) == 4
    assert everything(uri) == first


def test_progress_is_shown_run_by_run(tmp_path: Path, uri: str) -> None:
    """Whoever waits sees how many are done, of how many."""
    for name in ("a", "b"):
        build_run(tmp_path / name, ENTRIES[:1], whole=False)
    shown: list[tuple[int, int]] = []
    track(tmp_path, uri, lambda done, total: shown.append((done, total)))
    assert shown == [(0, 2), (1, 2), (2, 2)]


def test_store_that_is_not_there_is_asked_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each further run would wait as long, for nothing; and no password is shown."""
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    for name in ("a", "b"):
        build_run(tmp_path / name, ENTRIES[:1])
    tracked = track(tmp_path, "http://user:s3cret@127.0.0.1:9", quietly)
    first, second = tracked.failed
    assert "could not be written to http://***@127.0.0.1:9: " in first
    assert "the same command writes what is missing" in first
    assert "was not tried" in second
    assert "s3cret" not in first + second


def test_killed_command_is_completed_by_the_next(tmp_path: Path, uri: str) -> None:
    """Killed in the middle of a run, and given again, it leaves what an undisturbed one leaves."""
    many = [{**BASELINE, "slot": slot, "id": f"g00s{slot:02}"} for slot in range(40)]
    for name in ("a", "b"):
        build_run(tmp_path / "runs" / name, [ENTRIES[0], *many, ENTRIES[-2]])
    database = tmp_path / "killed.db"
    killed = f"sqlite:///{database}"
    command = [sys.executable, "-m", "tacevo.cli.app", "track", str(tmp_path / "runs"), "--uri", killed]
    with subprocess.Popen(command) as process:
        wait_for_runs(database, 10)
        process.kill()
    assert process.returncode < 0, "it was done before it could be killed"
    track(tmp_path / "runs", killed, quietly)
    track(tmp_path / "runs", uri, quietly)
    assert everything(killed) == everything(uri)


def wait_for_runs(database: Path, number: int) -> None:
    """Wait until a store has so many runs."""
    deadline = time.monotonic() + PATIENCE
    while not database.exists() or runs_in(database) < number:
        assert time.monotonic() < deadline, f"{number} runs did not come within {PATIENCE} s"
        time.sleep(0.05)


def runs_in(database: Path) -> int:
    """Count the runs of a store, which others may be writing."""
    connection = sqlite3.connect(f"file:{database}?mode=ro", uri=True, timeout=PATIENCE)
    try:
        (number,) = connection.execute("select count(*) from runs").fetchone()
    finally:
        connection.close()
    return int(number)


def test_run_that_cannot_be_written_to_can_be_tracked(tmp_path: Path, uri: str) -> None:
    """A published run on a read-only disk, say: nothing is written beside it, and nothing twice."""
    build_run(tmp_path / "runs" / "a", ENTRIES)
    before = files_below(tmp_path / "runs")
    with read_only(tmp_path / "runs"):
        assert track(tmp_path / "runs", uri, quietly).failed == ()
        first = everything(uri)
        assert track(tmp_path / "runs", uri, quietly).failed == ()
    assert everything(uri) == first
    assert files_below(tmp_path / "runs") == before


def test_folder_that_cannot_be_searched_is_told_of(tmp_path: Path, uri: str) -> None:
    """A path that is too long for the system, say: the status tells, and the runs elsewhere are written."""
    build_run(tmp_path / "runs" / "a", ENTRIES[:2])
    handle = os.open(tmp_path / "runs", os.O_RDONLY)
    for _ in range(18):
        os.mkdir("d" * 250, dir_fd=handle)
        below = os.open("d" * 250, os.O_RDONLY, dir_fd=handle)
        os.close(handle)
        handle = below
    os.close(handle)
    tracked = track(tmp_path / "runs", uri, quietly)
    assert tracked.done == (tmp_path / "runs" / "a",)
    (reason,) = tracked.failed
    assert "cannot be read: File name too long" in reason


def test_run_that_is_being_mirrored_is_not_waited_for(tmp_path: Path, uri: str) -> None:
    """Its search's mirror may be at it for hours; the others are written meanwhile."""
    for name in ("a", "b"):
        build_run(tmp_path / "runs" / name, ENTRIES[:2])
    with alone(tmp_path / "runs" / "a"):
        tracked = track(tmp_path / "runs", uri, quietly)
    assert tracked.done == (tmp_path / "runs" / "b",)
    assert "runs/a: expected an idle run" in tracked.failed[0]


def test_search_at_work_is_shown_as_running(tmp_path: Path, uri: str) -> None:
    """What stands there so far is written; without its search the run counts as killed."""
    build_run(tmp_path / "a", ENTRIES[:2], whole=False)
    with RunDirectory(tmp_path / "a").locked():
        track(tmp_path / "a", uri, quietly)
    assert everything(uri)["a",][1] == "RUNNING"
    track(tmp_path / "a", uri, quietly)
    assert everything(uri)["a",][1] == "KILLED"


@pytest.mark.parametrize(
    ("uri", "reason"),
    [
        ("sqlite:///{folder}/notes.db", "is no SQLite database: it begins with b'My notes'"),
        ("sqlite:///{folder}", "IsADirectoryError"),
        ("nonsense://user:s3cret@nowhere", "UnsupportedModelRegistryStoreURIException"),
        ("nosuch+driver://user:s3cret@nowhere/db?key=s3cret", "could not be written to"),
        ("postgresql://user:s3cret@127.0.0.1:9/db", "install the database driver that this address needs"),
    ],
)
def test_address_that_leads_nowhere_is_the_users_mistake(
    uri: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever class of error a driver has for it, it is one line, without the password."""
    build_run(tmp_path / "a", ENTRIES[:1])
    (tmp_path / "notes.db").write_text("My notes")
    assert main(["track", str(tmp_path / "a"), "--uri", uri.format(folder=tmp_path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert reason in line
    assert "s3cret" not in line
    assert (tmp_path / "notes.db").read_text() == "My notes"


def test_run_that_the_store_fails_with_stops_no_other(
    tmp_path: Path, uri: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """A store that answers is not taken for absent, whatever it says of one run."""
    for name in ("a", "b"):
        build_run(tmp_path / "runs" / name, ENTRIES[:2])
    broken = "BEGIN SELECT json('no JSON'); END"  # an OperationalError, as of a database that is away
    connection = sqlite3.connect(tmp_path / "mlflow.db")
    connection.execute(f"CREATE TRIGGER broken BEFORE INSERT ON runs WHEN NEW.name = 'a' {broken}")
    connection.commit()
    connection.close()
    tracked = track(tmp_path / "runs", uri, quietly)
    assert tracked.done == (tmp_path / "runs" / "b",)
    (reason,) = tracked.failed
    assert "runs/a could not be written to" in reason
    assert capfd.readouterr().err == "", "MLflow tells of it at length"


def test_runs_are_counted_by_the_store_they_went_to(tmp_path: Path, uri: str, empty_store: Path) -> None:
    """Two stores have the runs that are theirs."""
    other = f"sqlite:///{shutil.copy(empty_store, tmp_path / 'other.db')}"
    for name, store in (("a", uri), ("b", uri), ("c", other)):
        build_run(tmp_path / "runs" / name, ENTRIES[:1])
        facts = tmp_path / "runs" / name / "run.json"
        run = json.loads(facts.read_text(encoding="utf-8"))
        run["config"]["tracking"]["uri"] = store
        facts.write_text(json.dumps(run), encoding="utf-8")
    assert [number for _, number in track(tmp_path / "runs", None, quietly).views] == [2, 1]


def test_damaged_sweep_is_named(tmp_path: Path, uri: str) -> None:
    """To which sweep its runs belong is not guessed; a run elsewhere is written."""
    build_sweep(tmp_path / "runs" / "sweep", ENTRIES[:2], arms=["none"])
    (tmp_path / "runs" / "sweep" / "sweep.json").write_text(json.dumps({"schema": 1}))
    build_run(tmp_path / "runs" / "alone", ENTRIES[:2])
    tracked = track(tmp_path / "runs", uri, quietly)
    assert tracked.done == (tmp_path / "runs" / "alone",)
    assert "sweep.json is damaged" in tracked.failed[0]
