"""Exported simulations: the loader reads the same tensors back, and the directory is whole or absent."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
from refusals import refused
from small_recordings import loaded, simulated

from tacevo.choices import SensorTask
from tacevo.data.simulator.written_files import write_files
from tacevo.data.sources.table import TableSource
from tacevo.errors import ConfigError, DataError


@pytest.mark.parametrize("task", [SensorTask.force, SensorTask.hardness])
def test_loading_an_export_gives_the_same_tensors(task: SensorTask, tmp_path: Path) -> None:
    """Images, targets, split, names and statistics are equal; parameters and units lie beside them."""
    source = simulated(task)
    write_files(source, tmp_path / "out", workers=1)
    table = TableSource(
        root=tmp_path / "out", table="labels.csv", image_column="image", target_columns=source.names, image_size=16
    )
    ours, theirs = loaded(source, tmp_path / "cache"), loaded(table, tmp_path / "cache")
    assert np.array_equal(table.catalogue().labels, source.catalogue().labels)
    assert theirs.facts == ours.facts
    told = json.loads((tmp_path / "out" / "simulation.json").read_text())
    assert told == {"data": source.describe(), "units": list(source.catalogue().units or ())}


def test_classes_are_refused(tmp_path: Path) -> None:
    """A table of classes would not be read back."""
    with refused(ConfigError, place="task", expected="force or hardness", got="grating"):
        write_files(simulated(SensorTask.grating), tmp_path / "out", workers=1)
    assert list(tmp_path.iterdir()) == []


def test_workers_change_no_byte(tmp_path: Path) -> None:
    """Three threads write the files of one, and tell how far they are."""
    seen: list[tuple[int, int]] = []
    for workers in (1, 3):
        made = write_files(
            simulated(images=40), tmp_path / str(workers), workers=workers, progress=lambda *told: seen.append(told)
        )
        assert made == 40
    files = [sorted(path for path in (tmp_path / str(number)).rglob("*") if path.is_file()) for number in (1, 3)]
    assert [file.read_bytes() for file in files[0]] == [file.read_bytes() for file in files[1]]
    assert seen == [(32, 40), (40, 40)] * 2


def stop(done: int, total: int) -> NoReturn:
    """Interrupt as Ctrl-C does."""
    raise KeyboardInterrupt


def test_interrupted_export_leaves_nothing(tmp_path: Path) -> None:
    """Neither the directory nor a hidden part of it."""
    with pytest.raises(KeyboardInterrupt):
        write_files(simulated(), tmp_path / "out", workers=1, progress=stop)
    assert list(tmp_path.iterdir()) == []


def fill(out: Path) -> None:
    """Put a file into a directory."""
    out.mkdir()
    (out / "mine.txt").write_text("mine")


@pytest.mark.parametrize("occupy", [fill, Path.mkdir, Path.touch, lambda out: out.symlink_to(out.parent)])
def test_what_exists_is_refused_and_kept(occupy: Callable[[Path], object], tmp_path: Path) -> None:
    """Nothing of the user's is overwritten, nor the ground taken from under a shell."""
    occupy(tmp_path / "out")
    before = sorted(tmp_path.rglob("*"))
    with refused(DataError, place="out", expected="a new directory", got="out, which exists"):
        write_files(simulated(), tmp_path / "out", workers=1)
    assert sorted(tmp_path.rglob("*")) == before


def test_folder_that_is_filled_meanwhile_is_kept(tmp_path: Path) -> None:
    """The process that is first keeps the name."""
    out = tmp_path / "out"
    source = simulated()
    with pytest.raises(OSError, match="not empty"):
        write_files(source, out, workers=1, progress=lambda done, total: fill(out) if done == total else None)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert [path.name for path in out.iterdir()] == ["mine.txt"]
