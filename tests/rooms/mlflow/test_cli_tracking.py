"""Tracking is beside the search: with MLflow, without it and with a broken one, the same search is the same run."""

import json
import shutil
from pathlib import Path
from typing import NamedTuple

import pytest
from commands import tacevo
from interruptions import PATIENCE, mirrored
from smallest import SMALLEST
from tiny_sweep import SIZES
from waiting import eventually

CANDIDATES = 1 + 1 + 2


class Searched(NamedTuple):
    """A finished search: its directory, its run directory below it, and what it printed."""

    folder: Path
    run: Path
    digest: str
    errors: str


def searched(folder: Path, answers: Path, *tracking: str) -> Searched:
    """Search to the end in a directory, from a copy of the stores of `swept`, which have every answer."""
    shutil.copytree(answers / "cache", folder / "cache")
    done = tacevo("search", *SMALLEST, *SIZES, *tracking, cwd=folder)
    (run,) = (folder / "runs").iterdir()
    return Searched(folder, run, done.stdout.splitlines()[-1], done.stderr)


@pytest.fixture(scope="module")
def untracked(swept: Path) -> str:
    """Return what the same search without tracking printed last."""
    run = json.loads((swept / "sweep" / "none-seed0" / "run.json").read_text())
    return f"digest: {run['digest']}"


@pytest.fixture(scope="module")
def tracked(swept: Path, empty_store: Path, tmp_path_factory: pytest.TempPathFactory) -> Searched:
    """Return a search that MLflow mirrors into an empty SQLite database in its directory."""
    folder = tmp_path_factory.mktemp("tracked")
    shutil.copy(empty_store, folder)
    return searched(folder, swept, "tracking=mlflow", f"tracking.uri={database(folder)}")


def database(folder: Path) -> str:
    """Name the tracking URI of the database in a directory."""
    return f"sqlite:///{folder}/mlflow.db"


@pytest.mark.slow
def test_tracking_changes_no_bit(untracked: str, tracked: Searched) -> None:
    """A mirrored search has the digest of one that is not mirrored, and stands in MLflow with all candidates."""
    assert tracked.digest == untracked
    whole = (1 + CANDIDATES, tracked.digest.removeprefix("digest: "))
    # a slow mirror may still be at work
    assert eventually(lambda: mirrored(tracked.folder / "mlflow.db") == whole, seconds=PATIENCE)


@pytest.mark.slow
def test_broken_store_is_a_warning_and_nothing_else(untracked: str, swept: Path, tmp_path: Path) -> None:
    """With a database that cannot be made the search ends well, with the same digest and one line of warning."""
    broken = searched(tmp_path, swept, "tracking=mlflow", "tracking.uri=sqlite:////proc/nope/x.db")
    assert broken.digest == untracked
    (warning,) = [line for line in broken.errors.splitlines() if "MLflow mirror" in line]
    assert "sqlite:////proc/nope/x.db" in warning


def test_search_without_tracking_leaves_no_trace_of_it(whole_search: tuple[Path, str]) -> None:
    """Neither a database nor a log of the mirror is made."""
    folder, _ = whole_search
    assert not (folder / "mlflow.db").exists()
    assert not (folder / "run" / "tracking.log").exists()
