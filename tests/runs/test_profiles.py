"""The profiles of a run are recalled from its store, and probed anew, confined, only where they are missing."""

import json
import shutil
from pathlib import Path

import pytest
from refusals import refused
from smallest import ARCHIVES, UNTRACKED

from analysis.motifs.motifs import read_anatomies
from analysis.runs.run import load_run
from tacevo.choices import Confinement
from tacevo.cli.app import main
from tacevo.errors import RunError, SandboxError
from tacevo.runs.profiles import recall_profiles


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the folder of one finished search, as small as one can be."""
    folder = tmp_path_factory.mktemp("searched")
    small = ["search.generations=0", "search.initial=2", "data.images=40", "training.epochs=1", "run.dir=run"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(["search", "experiment=demo", *ARCHIVES, UNTRACKED, *small]) == 0
    return folder


@pytest.fixture
def folder(searched: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a copy of the finished search."""
    shutil.copytree(searched, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_profiles_are_those_of_the_ledger(folder: Path) -> None:
    """Every trained candidate has one, with its parameters, and its anatomy can be read."""
    hand = load_run(folder / "run")
    profiles = recall_profiles(folder / "run", None)
    trained = [candidate for candidate in hand.candidates if candidate.trained]
    assert list(profiles) == [candidate.id for candidate in trained]
    for candidate in trained:
        assert candidate.measured is not None
        assert profiles[candidate.id].parameters == candidate.measured.parameters
    assert read_anatomies(hand, profiles)["g00s00"].head == (512, 3)


def test_recorded_probes_are_believed(folder: Path) -> None:
    """Nothing is added to the store where everything is there."""
    before = {path: path.stat().st_mtime_ns for path in (folder / "cache" / "probes").rglob("*.json")}
    recall_profiles(folder / "run", None)
    assert {path: path.stat().st_mtime_ns for path in (folder / "cache" / "probes").rglob("*.json")} == before


def test_only_a_missing_probe_needs_the_sandbox(folder: Path) -> None:
    """What is recorded is read on a machine that can confine nothing; what is not, is never run there."""

    def refuse(level: Confinement) -> None:
        raise SandboxError(f"no {level} here")

    assert recall_profiles(folder / "run", None, confine=refuse)
    next((folder / "cache" / "probes").rglob("*.json")).unlink()
    with pytest.raises(SandboxError, match="no process here"):
        recall_profiles(folder / "run", None, confine=refuse)


def test_missing_probes_are_made_alike(folder: Path) -> None:
    """As for a run of an older version; and in a store that lies elsewhere."""
    before = recall_profiles(folder / "run", None)
    shutil.rmtree(folder / "cache" / "probes")
    assert recall_profiles(folder / "run", "elsewhere") == before
    assert list((folder / "elsewhere" / "probes").rglob("*.json"))


def test_edited_source_is_refused(folder: Path) -> None:
    """What was trained is what is looked at."""
    path = folder / "run" / "candidates" / "g00s00.py"
    path.write_text(path.read_text() + "# edited\n")
    with refused(RunError, place="g00s00.py", got="missing or was edited"):
        recall_profiles(folder / "run", None)


def test_source_that_is_turned_away_now_is_named(folder: Path) -> None:
    """Under a limit that the run did not have, e.g. because its description was edited."""
    path = folder / "run" / "run.json"
    run = json.loads(path.read_text())
    run["config"]["gate"]["max_parameters"] = 10
    path.write_text(json.dumps(run))
    with refused(RunError, place="g00s00 of ", got="too_many_parameters"):
        recall_profiles(folder / "run", None)
