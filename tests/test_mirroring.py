"""All runs below a folder come into MLflow, each once; what is damaged is named, and nothing is written beside it."""

import json
import os
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mirrored import BASELINE, ENTRIES, build_run, build_sweep, everything

from tacevo.app import main
from tacevo.errors import RunError
from tacevo.mirroring import find_runs, track

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
    assert find_runs(tmp_path) == (tmp_path / "a" / "deep", tmp_path / "b")
    assert find_runs(tmp_path / "b") == (tmp_path / "b",)


@pytest.mark.parametrize("name", ["empty", "missing"])
def test_folder_without_a_run_is_the_users_mistake(name: str, tmp_path: Path) -> None:
    """A mistyped folder is told of."""
    (tmp_path / "empty").mkdir()
    with pytest.raises(RunError, match=r"neither the folder of a run .* nor holds one"):
        find_runs(tmp_path / name)


def test_damaged_run_is_named_and_the_others_are_written(
    tmp_path: Path, uri: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Status 1, a line for each damaged run, nothing of these in MLflow, and no file of any run is touched."""
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
    assert files_below(runs) == before


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
    command = [sys.executable, "-m", "tacevo.app", "track", str(tmp_path / "runs"), "--uri", killed]
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
    """A published run on a read-only disk, say: nothing is written beside it."""
    build_run(tmp_path / "runs" / "a", ENTRIES)
    for folder in (tmp_path / "runs" / "a", tmp_path / "runs"):
        folder.chmod(0o555)
    try:
        before = os.listdir(tmp_path / "runs" / "a")
        assert track(tmp_path / "runs", uri, quietly).failed == ()
        assert os.listdir(tmp_path / "runs" / "a") == before
    finally:
        for folder in (tmp_path / "runs", tmp_path / "runs" / "a"):
            folder.chmod(0o755)


def test_damaged_sweep_is_named(tmp_path: Path, uri: str) -> None:
    """To which sweep its runs belong is not guessed; a run elsewhere is written."""
    build_sweep(tmp_path / "runs" / "sweep", ENTRIES[:2], arms=["none"])
    (tmp_path / "runs" / "sweep" / "sweep.json").write_text(json.dumps({"schema": 1}))
    build_run(tmp_path / "runs" / "alone", ENTRIES[:2])
    tracked = track(tmp_path / "runs", uri, quietly)
    assert tracked.done == (tmp_path / "runs" / "alone",)
    assert "sweep.json is damaged" in tracked.failed[0]
