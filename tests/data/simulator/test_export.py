"""Exported simulations: the loader reads the same tensors back, and the directory is whole or absent."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
from refusals import refused
from small_recordings import loaded

from tacevo.choices import LightScene, SensorTask
from tacevo.data.simulator.export import export
from tacevo.data.simulator.tasks import Simulated
from tacevo.data.sources.table import Table
from tacevo.data.workers import FEW_PICTURES
from tacevo.errors import ConfigError, DataError


def simulated(task: SensorTask = SensorTask.force, *, images: int = 24) -> Simulated:
    """Describe a small simulation."""
    return Simulated(
        task=task,
        images=images,
        image_size=20,
        seed=5,
        sensor_seed=1,
        light=LightScene.standard,
        spacings_mm=(0.3, 2.0),
    )


@pytest.mark.parametrize("task", [SensorTask.force, SensorTask.hardness])
def test_loading_an_export_gives_the_same_tensors(task: SensorTask, tmp_path: Path) -> None:
    """Images, targets, split, names and statistics are equal, hence the fingerprint; every bit of a label survives."""
    source = simulated(task)
    export(source, tmp_path / "out", workers=1)
    table = Table(
        root=tmp_path / "out",
        table="labels.csv",
        image_column="image",
        target_columns=source.names,
        image_size=20,
    )
    ours, theirs = loaded(source, tmp_path / "cache"), loaded(table, tmp_path / "cache")
    assert np.array_equal(table.catalogue().labels, source.catalogue().labels)
    assert np.array_equal(np.load(theirs.images), np.load(ours.images))
    for name in ("targets", "train", "validation", "test"):
        assert np.array_equal(getattr(theirs, name), getattr(ours, name)), name
    assert theirs.facts == ours.facts


def test_export_says_what_it_is(tmp_path: Path) -> None:
    """Parameters, units and a command that reads the directory lie beside the images."""
    source = simulated()
    export(source, tmp_path / "out", workers=1)
    assert json.loads((tmp_path / "out" / "simulation.json").read_text()) == source.describe()
    text = (tmp_path / "out" / "README.md").read_text()
    assert "data=csv data.root=out 'data.target_columns=[Fx,Fy,Fz]' data.split=random" in text
    assert "Fz in N" in text


def test_classes_are_refused(tmp_path: Path) -> None:
    """A table of classes would not be read back."""
    with refused(ConfigError, place="task", expected="force or hardness", got="grating"):
        export(simulated(SensorTask.grating), tmp_path / "out", workers=1)
    assert list(tmp_path.iterdir()) == []


def test_workers_change_no_byte(tmp_path: Path) -> None:
    """Two processes write the files of one."""
    source = simulated(images=FEW_PICTURES + 40)  # more than one process from there on
    for workers in (1, 2):
        assert export(source, tmp_path / "out", workers=workers) == FEW_PICTURES + 40
        (tmp_path / "out").rename(tmp_path / str(workers))
    files = [sorted(path for path in (tmp_path / str(number)).rglob("*") if path.is_file()) for number in (1, 2)]
    assert len(files[0]) == FEW_PICTURES + 43
    assert [file.read_bytes() for file in files[0]] == [file.read_bytes() for file in files[1]]


def test_progress_counts_up_to_all_images(tmp_path: Path) -> None:
    """Progress is told per chunk and ends with everything done."""
    seen: list[tuple[int, int]] = []
    source = simulated(images=40)
    export(source, tmp_path / "out", workers=1, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(32, 40), (40, 40)]


def stop(done: int, total: int) -> NoReturn:
    """Interrupt as Ctrl-C does."""
    raise KeyboardInterrupt


def test_interrupted_export_leaves_nothing(tmp_path: Path) -> None:
    """Neither the directory nor a hidden part of it."""
    with pytest.raises(KeyboardInterrupt):
        export(simulated(), tmp_path / "out", workers=1, progress=stop)
    assert list(tmp_path.iterdir()) == []


def fill(out: Path) -> None:
    """Put a file into a directory."""
    out.mkdir()
    (out / "mine.txt").write_text("mine")


def make_file(out: Path) -> None:
    """Make a file instead of a directory."""
    out.write_text("mine")


@pytest.mark.parametrize("occupy", [fill, make_file])
def test_occupied_folder_is_refused_and_kept(occupy: Callable[[Path], None], tmp_path: Path) -> None:
    """Nothing of the user's is overwritten."""
    occupy(tmp_path / "out")
    with refused(DataError, place="out", expected="a new directory", got="not empty"):
        export(simulated(), tmp_path / "out", workers=1)
    assert [path.read_text() for path in tmp_path.rglob("*") if path.is_file()] == ["mine"]


@pytest.mark.parametrize("out", [".", "./", "made/.."])
def test_current_folder_is_refused_before_anything_is_drawn(
    out: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is empty, but to replace it would take the ground from under the user's shell."""
    monkeypatch.chdir(tmp_path)
    seen: list[tuple[int, int]] = []
    with refused(DataError, place="out", expected="a new directory", got="the current directory"):
        export(simulated(), Path(out), workers=1, progress=lambda *told: seen.append(told))
    assert (seen, list(tmp_path.iterdir())) == ([], [])


def test_link_to_an_empty_folder_is_followed(tmp_path: Path) -> None:
    """The directory behind it is filled, and the link stays."""
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    export(simulated(), tmp_path / "out", workers=1)
    assert (tmp_path / "out").is_symlink()
    assert (tmp_path / "disk" / "simulation.json").is_file()


def test_folder_that_is_filled_meanwhile_is_kept(tmp_path: Path) -> None:
    """The process that is first keeps the name."""
    out = tmp_path / "out"
    source = simulated()
    with pytest.raises(OSError, match="not empty"):
        export(source, out, workers=1, progress=lambda done, total: fill(out) if done == total else None)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert [path.name for path in out.iterdir()] == ["mine.txt"]


def test_empty_folder_is_filled(tmp_path: Path) -> None:
    """A directory that exists and is empty is used."""
    (tmp_path / "out").mkdir()
    export(simulated(), tmp_path / "out", workers=1)
    assert (tmp_path / "out" / "simulation.json").is_file()
