"""A recorded run is read as what it was, and only as far as this machine can bear."""

import json
import os
from pathlib import Path

import pytest
from refusals import refused
from rich.console import Console

from tacevo.errors import ConfigError, DivergenceError, RunError
from tacevo.reproduce.replay import replay
from tacevo.results.run import read_run
from tacevo.results.settings import read_settings, settings_of
from tacevo.runs.progress import Progress
from tacevo.storage.run_directory import RunDirectory


@pytest.fixture
def run(published: Path) -> Path:
    """Return the directory of a finished run."""
    return published / "run"


def with_setting(run: Path, folder: Path, group: str, key: str, value: int) -> RunDirectory:
    """Return a run.json with one setting edited."""
    described = json.loads((run / "run.json").read_text())
    described["config"][group][key] = value
    (folder / "run.json").write_text(json.dumps(described))
    return RunDirectory(folder)


def test_recorded_workers_are_no_more_than_there_are_cores(run: Path, tmp_path: Path) -> None:
    """A run of a large machine, or one that was made up, starts no thousand processes here."""
    config = settings_of(with_setting(run, tmp_path, "executor", "workers", 10_000))
    assert config.executor.workers == len(os.sched_getaffinity(0))


@pytest.mark.parametrize("images", [10, 10**7])
def test_images_are_those_of_the_recorded_data_set(images: int, run: Path, tmp_path: Path) -> None:
    """Nobody simulates ten million images to find that they are not those of the run."""
    with refused(RunError, place="data.images", expected="the 40 images", got=str(images)):
        settings_of(with_setting(run, tmp_path, "data", "images", images))


def test_pool_fits_the_recorded_library(run: Path, tmp_path: Path) -> None:
    """A made-up run cannot ask for more instructions than it has."""
    with refused(ConfigError, place="prompts.pool", expected="at most 20"):
        settings_of(with_setting(run, tmp_path, "prompts", "pool", 21))


def test_stores_may_lie_elsewhere(run: Path, tmp_path: Path) -> None:
    """The caller's word counts; without it the run's own."""
    elsewhere = read_settings(RunDirectory(run), RunDirectory(run).read_run(), str(tmp_path))
    own = settings_of(RunDirectory(run))
    assert elsewhere.store.root == str(tmp_path)
    assert own.store.root == str(run.parent / "cache")


def test_run_with_more_lines_than_its_settings_ask_for_is_named(folder: Path) -> None:
    """A generation that no search by these settings makes is not passed over."""
    described = json.loads((folder / "run" / "run.json").read_text())
    described["config"]["search"]["generations"] = 0
    (folder / "run" / "run.json").write_text(json.dumps(described))
    with refused(DivergenceError, place="ledger.jsonl", expected="5 lines", got="9 lines"):
        replay(read_run(Path("run")), Progress(Console(quiet=True)))
