"""A recorded run is read as what it was, and only as far as this machine can bear."""

import json
import os
from pathlib import Path
from typing import Any

import pytest
from refusals import refused
from rich.console import Console

from tacevo.errors import DivergenceError, TacevoError
from tacevo.reproduce.replay import replay
from tacevo.results.run import read_run
from tacevo.results.settings import read_settings, settings_of
from tacevo.runs.progress import Progress
from tacevo.storage.run_directory import RunDirectory


@pytest.fixture
def run(published: Path) -> Path:
    """Return the directory of a finished run."""
    return published / "run"


def with_config(run: Path, folder: Path, **groups: Any) -> RunDirectory:
    """Write a run.json whose groups of settings have other values, or are others."""
    described = json.loads((run / "run.json").read_text())
    for group, settings in groups.items():
        described["config"][group].update(settings)
    (folder / "run.json").write_text(json.dumps(described))
    return RunDirectory(folder)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"data": {"source": "simulated", "images": 10}}, {"place": "data.images", "expected": "the 40 images"}),
        ({"data": {"source": "simulated", "images": 10**7}}, {"place": "data.images", "expected": "the 40 images"}),
        ({"prompts": {"pool": 21}}, {"place": "prompts.pool", "expected": "at most 20"}),
        ({"search": {"beams": 1}}, {"place": "run.json", "expected": "a configuration of this version"}),
    ],
)
def test_settings_of_another_run_or_version_are_refused(
    changes: dict[str, Any], named: dict[str, str], run: Path, tmp_path: Path
) -> None:
    """Nobody simulates ten million images to find that they are not those of the run; no default is taken."""
    with refused(TacevoError, **named):
        settings_of(with_config(run, tmp_path, **changes))


def test_machine_of_a_recorded_run_is_this_one(run: Path, tmp_path: Path) -> None:
    """A run of a large machine, or one that was made up, starts no thousand processes; stores may lie elsewhere."""
    directory = with_config(run, tmp_path, executor={"workers": 10_000})
    assert settings_of(directory).executor.workers == len(os.sched_getaffinity(0))
    assert settings_of(directory).store.root == str(run.parent / "cache")
    assert read_settings(directory, directory.read_run(), str(tmp_path)).store.root == str(tmp_path)


def test_run_with_more_lines_than_its_settings_ask_for_is_named(folder: Path) -> None:
    """A generation that no search by these settings makes is not passed over."""
    described = json.loads((folder / "run" / "run.json").read_text())
    described["config"]["search"]["generations"] = 0
    (folder / "run" / "run.json").write_text(json.dumps(described))
    with refused(DivergenceError, place="ledger.jsonl", expected="5 lines", got="9 lines"):
        replay(read_run(Path("run")), Progress(Console(quiet=True)))
