"""The profiles of a run are recalled from its store, and probed anew, confined, only where they are missing."""

import json
import shutil
from pathlib import Path

import pytest

from analysis.motifs.motifs import read_anatomies
from analysis.runs.run import load_run
from tacevo.choices import Confinement
from tacevo.errors import RunError, SandboxError
from tacevo.runs.profiles import recall_profiles
from tacevo.storage.run_directory import RunDirectory


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
    with pytest.raises(RunError, match=r"g00s00\.py is missing or was edited"):
        recall_profiles(folder / "run", None)


def test_source_that_is_turned_away_now_is_named(folder: Path) -> None:
    """Under a limit that the run did not have, e.g. because its description was edited."""
    run = RunDirectory(folder / "run").read_run()
    run["config"]["gate"]["max_parameters"] = 10
    (folder / "run" / "run.json").write_text(json.dumps(run))
    with pytest.raises(RunError, match=r"g00s00 of .* was trained, but is turned away now: too_many_parameters"):
        recall_profiles(folder / "run", None)
