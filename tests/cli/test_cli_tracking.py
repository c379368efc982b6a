"""Tracking is beside the search: with MLflow, without it and with a broken one, the same search is the same run."""

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest
from commands import tacevo
from smallest import SMALLEST
from tiny_sweep import SIZES

from tacevo.cli.app import main
from tacevo.storage.files import alone

if TYPE_CHECKING:
    from mlflow.entities import Run

# MLflow uses a loader option of SQLAlchemy that its newest version deprecates.
pytestmark = pytest.mark.filterwarnings("ignore:The ``noload`` loader strategy is deprecated")

CANDIDATES = 1 + 1 + 2


class Searched(NamedTuple):
    """A finished search: its folder, its run directory below it, and what it printed."""

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
def untracked(swept: Path, tmp_path_factory: pytest.TempPathFactory) -> Searched:
    """Give a search without tracking."""
    return searched(tmp_path_factory.mktemp("untracked"), swept, "tracking=none")


@pytest.fixture(scope="module")
def tracked(swept: Path, empty_store: Path, tmp_path_factory: pytest.TempPathFactory) -> Searched:
    """Give a search that MLflow mirrors into an empty SQLite database in its directory."""
    folder = tmp_path_factory.mktemp("tracked")
    shutil.copy(empty_store, folder)
    return searched(folder, swept, "tracking=mlflow", f"tracking.uri={database(folder)}")


def database(folder: Path) -> str:
    """Name the tracking URI of the database in a folder."""
    return f"sqlite:///{folder}/mlflow.db"


def runs_in(uri: str, monkeypatch: pytest.MonkeyPatch) -> "list[Run]":
    """Read every run of a store."""
    monkeypatch.setenv("MLFLOW_DISABLE_TELEMETRY", "true")
    from mlflow import MlflowClient

    client = MlflowClient(uri)
    experiment = client.get_experiment_by_name("tacevo")
    assert experiment is not None
    return list(client.search_runs([experiment.experiment_id]))


def said_by(runs: "list[Run]") -> dict[str, object]:
    """Give all that runs say of themselves, by id."""
    return {run.info.run_id: run.to_dictionary() for run in runs}


def test_tracking_changes_no_bit(untracked: Searched, tracked: Searched) -> None:
    """A mirrored search has the digest of one that is not mirrored."""
    assert tracked.digest == untracked.digest
    assert tracked.digest.startswith("digest: ")


@pytest.mark.slow
def test_broken_store_is_a_warning_and_nothing_else(untracked: Searched, swept: Path, tmp_path: Path) -> None:
    """With a database that cannot be made the search ends well, with the same digest and one line of warning."""
    broken = searched(tmp_path, swept, "tracking=mlflow", "tracking.uri=sqlite:////proc/nope/x.db")
    assert broken.digest == untracked.digest
    (warning,) = [line for line in broken.errors.splitlines() if "MLflow mirror" in line]
    assert "sqlite:////proc/nope/x.db" in warning


def test_search_without_tracking_leaves_no_trace_of_it(untracked: Searched) -> None:
    """Neither a database nor a log of the mirror is made."""
    assert not (untracked.folder / "mlflow.db").exists()
    assert not (untracked.run / "tracking.log").exists()


def test_track_again_adds_nothing(tracked: Searched, monkeypatch: pytest.MonkeyPatch) -> None:
    """MLflow holds one parent and a nested run a candidate; `tacevo track` twice leaves them as they are."""
    with alone(tracked.run):  # a slow mirror may still be at work until here
        pass
    assert main(["track", str(tracked.run)]) == 0
    first = runs_in(database(tracked.folder), monkeypatch)
    (parent,) = [run for run in first if "tacevo.run" in run.data.tags]
    nested = [run for run in first if run.data.tags.get("mlflow.parentRunId") == parent.info.run_id]
    assert len(nested) == CANDIDATES == len(first) - 1
    assert f"digest: {parent.data.tags['tacevo.digest']}" == tracked.digest
    assert main(["track", str(tracked.run)]) == 0
    second = runs_in(database(tracked.folder), monkeypatch)
    assert said_by(second).keys() == said_by(first).keys()
    assert [said_by(second)[run.info.run_id] for run in nested] == [said_by(first)[run.info.run_id] for run in nested]


def test_untracked_run_can_be_tracked_later(
    untracked: Searched, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`tacevo track --uri` builds the store from the run directory alone."""
    assert main(["track", str(untracked.run), "--uri", database(tmp_path)]) == 0
    assert len(runs_in(database(tmp_path), monkeypatch)) == 1 + CANDIDATES


def test_track_without_a_uri_is_the_users_mistake(
    untracked: Searched, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run made with tracking=none does not name a store: status 2, and one line that says what to set."""
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    assert main(["track", str(untracked.run)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "--uri" in line
