"""All runs below a directory come into MLflow, each once; a damaged one is named, and nothing is written there."""

import json
import sqlite3
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from mirrored import BASELINE, LINES, MUTATION, build_run, build_sweep, everything
from refusals import refused
from waiting import eventually

from tacevo.cli.app import main
from tacevo.environment import as_typed
from tacevo.errors import ConfigError, RunError
from tacevo.storage.run_directory import RunDirectory
from tacevo.tracking.mirror import alone
from tacevo.tracking.track import find_runs, track

#: Seconds after which a process is taken for stuck; machines are busy.
PATIENCE = 300


def quietly(done: int, total: int) -> None:
    """Show nothing."""


def files_below(directory: Path) -> dict[Path, bytes]:
    """Return every file below a directory, with its content."""
    return {path: path.read_bytes() for path in directory.rglob("*") if path.is_file()}


def test_runs_are_found_at_any_depth_by_name(tmp_path: Path) -> None:
    """A run's own directories are not searched, nor are hidden ones, nor what a link points to."""
    for name in ("b", "a/deep", ".hidden", "b/studies/inner"):
        build_run(tmp_path / name, LINES[:1])
    (tmp_path / "again").symlink_to(tmp_path / "b")
    assert find_runs(tmp_path) == (tmp_path / "a" / "deep", tmp_path / "b")
    assert find_runs(tmp_path / "b") == (tmp_path / "b",)


def test_directory_without_a_run_is_the_users_mistake(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A mistyped one is named, and a file, such as a bundle, is not taken for a directory without runs."""
    (tmp_path / "empty").mkdir()
    for name in ("empty", "missing"):
        with refused(RunError, place=name, expected="a run directory"):
            find_runs(tmp_path / name)
    (tmp_path / "run.zip").write_bytes(b"PK")
    assert main(["track", str(tmp_path / "run.zip")]) == 2
    assert "run.zip: Not a directory" in capsys.readouterr().err


@pytest.mark.slow
def test_damaged_run_is_named_and_the_others_are_written(
    tmp_path: Path, uri: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Status 1, a line for each damaged run, nothing of these in MLflow, and no file changes."""
    runs = tmp_path / "runs"
    for name in ("a", "edited", "lost", "z"):
        build_run(runs / name, LINES)
    build_sweep(runs / "sweep", LINES[:2], arms=["none"])
    (runs / "sweep" / "sweep.json").write_text(json.dumps({"schema": 1}))
    ledger = runs / "edited" / "ledger.jsonl"
    ledger.write_text(ledger.read_text(encoding="utf-8").replace("0.25", "0.125", 1), encoding="utf-8")
    (runs / "lost" / "run.json").unlink()
    before = files_below(runs)
    assert main(["track", str(runs), "--uri", uri]) == 1
    out, errors = capsys.readouterr()
    assert "2 runs of" in out
    assert f" in MLflow: {as_typed('mlflow')} ui --backend-store-uri " in out
    edited, lost, sweep = errors.splitlines()
    assert "edited/ledger.jsonl, line 2: expected a line that matches its hash" in edited
    assert "lost: expected the directory of a run" in lost
    assert "sweep.json" in sweep
    assert {path[0] for path in everything(uri)} == {"a", "z"}
    assert files_below(runs) == before


@pytest.mark.slow
def test_tracking_a_directory_twice_changes_nothing(tmp_path: Path, uri: str) -> None:
    """A sweep and a run beside it, begun and finished jobs: the second time finds all of it."""
    build_sweep(tmp_path / "runs" / "sweep", LINES)
    build_run(tmp_path / "runs" / "sweep" / "none-seed1", LINES[:3], whole=False)
    build_run(tmp_path / "runs" / "alone", LINES)
    shown: list[tuple[int, int]] = []
    assert track(tmp_path / "runs", uri, lambda done, total: shown.append((done, total))) == ({uri: 4}, ())
    assert shown == [(0, 4), (1, 4), (2, 4), (3, 4), (4, 4)]
    first = everything(uri)
    assert first["sweep", "none-seed1"][1] == "KILLED"
    assert track(tmp_path / "runs", uri, quietly) == ({uri: 4}, ())
    assert everything(uri) == first


@pytest.mark.slow
def test_killed_command_is_completed_by_the_next(tmp_path: Path, uri: str) -> None:
    """Killed in the middle of a run, and given again, it leaves what an undisturbed one leaves."""
    many = [replace(BASELINE, slot=slot, id=f"g00s{slot:02}") for slot in range(40)]
    for name in ("a", "b"):
        build_run(tmp_path / "runs" / name, [LINES[0], *many, LINES[-2]])
    database = tmp_path / "killed.db"
    killed = f"sqlite:///{database}"
    command = [sys.executable, "-m", "tacevo.cli.app", "track", str(tmp_path / "runs"), "--uri", killed]
    with subprocess.Popen(command) as process:
        assert eventually(lambda: database.exists() and runs_in(database) >= 10, seconds=PATIENCE)
        process.kill()
    assert process.returncode < 0, "it was done before it could be killed"
    track(tmp_path / "runs", killed, quietly)
    track(tmp_path / "runs", uri, quietly)
    assert everything(killed) == everything(uri)


def runs_in(database: Path) -> int:
    """Count the runs of a store, to which another process may be writing."""
    connection = sqlite3.connect(f"file:{database}?mode=ro", uri=True, timeout=PATIENCE)
    try:
        (number,) = connection.execute("select count(*) from runs").fetchone()
    finally:
        connection.close()
    return int(number)


@pytest.mark.slow
def test_run_that_is_being_mirrored_is_not_waited_for(tmp_path: Path, uri: str) -> None:
    """Its search's mirror may take hours; the others are written meanwhile."""
    for name in ("a", "b"):
        build_run(tmp_path / "runs" / name, LINES[:2])
    with alone(tmp_path / "runs" / "a"):
        done, failed = track(tmp_path / "runs", uri, quietly)
    assert done == {uri: 1}
    assert "runs/a: expected an idle run" in failed[0]


def test_search_at_work_is_shown_as_running(tmp_path: Path, uri: str) -> None:
    """What stands there so far is written; without its search the run counts as killed."""
    build_run(tmp_path / "a", LINES[:2], whole=False)
    with RunDirectory(tmp_path / "a").locked():
        track(tmp_path / "a", uri, quietly)
    assert everything(uri)["a",][1] == "RUNNING"
    track(tmp_path / "a", uri, quietly)
    assert everything(uri)["a",][1] == "KILLED"


@pytest.mark.parametrize(
    ("uri", "got", "remedy"),
    [
        ("sqlite:////proc/nowhere/mlflow.db", "FileNotFoundError", "run the same command again"),
        ("nonsense://nowhere", "UnsupportedModelRegistryStoreURIException", "run the same command again"),
        ("postgresql://user@127.0.0.1:9/db", "ModuleNotFoundError", "install the database driver"),
        ("http://127.0.0.1:9", "MlflowException", "run the same command again"),
    ],
)
def test_store_that_fails_ends_the_command(
    uri: str, got: str, remedy: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever class of error a driver has, it is one line; the next run would meet the same failure."""
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    for name in ("a", "b"):
        build_run(tmp_path / name, LINES[:1])
    with refused(RunError, place=f"a into {uri}", got=got, remedy=remedy):
        track(tmp_path, uri, quietly)


def test_address_is_the_one_given_else_the_runs_else_that_of_the_environment(
    tmp_path: Path, uri: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An address of an earlier version, whose password was hidden, is not used; a missing one is an error."""
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    for name, own in (("own", uri), ("hidden", "postgresql://***@host/db"), ("none", "")):
        build_run(tmp_path / "runs" / name, LINES[:1], uri=own)
    done, failed = track(tmp_path / "runs", "", quietly)
    assert done == {uri: 1}
    assert all("tracking.uri: expected the address of an MLflow store" in reason for reason in failed)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    assert track(tmp_path / "runs", "", quietly) == ({uri: 1, "": 2}, ())
    assert {path[0] for path in everything(uri)} == {"own", "hidden", "none"}


def test_address_with_a_password_is_rejected(tmp_path: Path) -> None:
    """A command line can be read by every user of a machine."""
    with refused(ConfigError, place="--uri", remedy="MLFLOW_TRACKING_PASSWORD"):
        track(tmp_path, "postgresql://user:s3cret@host/db", quietly)


def test_run_whose_records_do_not_fit_is_named_and_the_others_are_written(tmp_path: Path, uri: str) -> None:
    """An instruction that the task does not have, sealed anew; or a setting that is not there, by its key."""
    build_run(tmp_path / "a", [*LINES[:2], replace(MUTATION, prompt=99)])
    for name in ("b", "c"):
        build_run(tmp_path / name, LINES)
    path = tmp_path / "b" / "run.json"
    run = json.loads(path.read_text())
    del run["config"]["tracking"]
    path.write_text(json.dumps(run))
    done, (line, setting) = track(tmp_path, uri, quietly)
    assert done == {uri: 1}
    assert f"{tmp_path}/a: expected the records of a run; got IndexError" in line
    assert "b/run.json, config, tracking.uri: expected a value" in setting
