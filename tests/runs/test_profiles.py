"""Promise: the profiles of a run are those of its store, and no candidate's code runs to read them."""

from pathlib import Path

import pytest
from refusals import refused

from tacevo.errors import CacheMissError, RunError
from tacevo.records import Reason, Rejection, Stage, to_json
from tacevo.results.run import read_run
from tacevo.runs.profiles import recall_profiles
from tacevo.storage.store import Store


def test_profiles_are_those_of_the_ledger(folder: Path) -> None:
    """Every trained candidate has one, with its parameters."""
    hand = read_run(folder / "run")
    profiles = recall_profiles(read_run(folder / "run"))
    assert [(name, profile.parameters) for name, profile in profiles.items()] == [
        (candidate.id, candidate.parameters) for candidate in hand.trained
    ]


def test_missing_probe_is_an_error(folder: Path) -> None:
    """No candidate's code runs to make it, and nothing is written."""
    for probe in (folder / "cache" / "probes").rglob("*.json"):
        probe.unlink()
    before = set(folder.rglob("*"))
    with pytest.raises(CacheMissError):
        recall_profiles(read_run(folder / "run"))
    assert set(folder.rglob("*")) == before


def test_network_that_its_store_rejects_is_refused(folder: Path) -> None:
    """The ledger says that it was trained."""
    store = Store(folder / "cache", "probes")
    rejection = Rejection(stage=Stage.probe, reason=Reason.crashed, detail="it exited")
    for entry in list(store.entries()):
        (folder / "cache" / entry.place).unlink()
        store.write(entry.request, {"rejection": to_json(rejection)})
    with refused(RunError, place="run", got="g00s00 was trained, and is rejected now: crashed: it exited"):
        recall_profiles(read_run(folder / "run"))


def test_edited_source_is_refused(folder: Path) -> None:
    """What was trained is what is looked at."""
    path = folder / "run" / "candidates" / "g00s00.py"
    path.write_text(path.read_text() + "# edited\n")
    with refused(RunError, place="g00s00.py", got="another source: the file was edited"):
        recall_profiles(read_run(folder / "run"))
