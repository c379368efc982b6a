"""Promise: the profiles of a run are those of its store, and no candidate's code runs to read them."""

import shutil
from pathlib import Path

import pytest
from smallest import ARCHIVES, UNTRACKED

from analysis.motifs.motifs import read_anatomies
from analysis.runs.run import load_run
from tacevo.cli.app import main
from tacevo.errors import CacheMissError, RunError
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
    assert [(name, profile.parameters) for name, profile in profiles.items()] == [
        (candidate.id, candidate.parameters) for candidate in hand.trained
    ]
    assert read_anatomies(hand, profiles)["g00s00"].head == (512, 3)


def test_missing_probe_is_an_error(folder: Path) -> None:
    """No candidate's code runs to make it, and nothing is written."""
    next((folder / "cache" / "probes").rglob("*.json")).unlink()
    before = set(folder.rglob("*"))
    with pytest.raises(CacheMissError):
        recall_profiles(folder / "run", None)
    assert set(folder.rglob("*")) == before


def test_edited_source_is_refused(folder: Path) -> None:
    """What was trained is what is looked at."""
    path = folder / "run" / "candidates" / "g00s00.py"
    path.write_text(path.read_text() + "# edited\n")
    with pytest.raises(RunError, match=r"g00s00\.py is missing or was edited"):
        recall_profiles(folder / "run", None)
