"""Exported simulations: the loader reads the same tensors back, and the directory is whole or absent."""

import csv
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
from refusals import refused
from small_recordings import loaded

from tacevo.choices import LightScene, SensorTask
from tacevo.data.simulator.export import PATTERN, export
from tacevo.data.simulator.tasks import Simulated
from tacevo.data.sources.tacverse import SIMULATED_SENSOR, SIMULATION, TacVerse
from tacevo.data.workers import FEW_PICTURES
from tacevo.errors import ConfigError, DataError

#: Enough of each class for every part of the split.
IMAGES = {SensorTask.force: 24, SensorTask.grating: 61, SensorTask.hardness: 24}


def simulated(task: SensorTask, *, images: int | None = None, spacings: tuple[float, ...] = (0.3, 2.0)) -> Simulated:
    """Describe a small simulation."""
    return Simulated(
        task=task,
        images=images or IMAGES[task],
        image_size=20,
        seed=5,
        sensor_seed=1,
        light=LightScene.standard,
        spacings_mm=spacings,
    )


def exported(root: Path, task: SensorTask) -> TacVerse:
    """Name an exported directory as a source."""
    return TacVerse(root=root, task=task, sensor=SIMULATED_SENSOR, pattern=PATTERN, image_size=20)


@pytest.mark.parametrize("task", SensorTask)
def test_loading_an_export_gives_the_same_tensors(task: SensorTask, tmp_path: Path) -> None:
    """Images, targets, split, names and statistics are equal, hence the fingerprint."""
    source = simulated(task)
    export(source, tmp_path / "out", workers=1)
    ours = loaded(source, tmp_path / "cache")
    theirs = loaded(exported(tmp_path / "out", task), tmp_path / "cache")
    assert np.array_equal(np.load(theirs.images), np.load(ours.images))
    for name in ("targets", "train", "validation", "test"):
        assert np.array_equal(getattr(theirs, name), getattr(ours, name)), name
    assert theirs.facts == ours.facts


@pytest.mark.parametrize("task", SensorTask)
def test_units_survive(task: SensorTask, tmp_path: Path) -> None:
    """What the simulation states of its labels is stated of its files."""
    export(simulated(task), tmp_path / "out", workers=1)
    assert exported(tmp_path / "out", task).catalogue().units == simulated(task).catalogue().units


def test_units_are_those_of_the_simulation_and_of_no_other_images(tmp_path: Path) -> None:
    """Images of another sensor in the same directory have no stated unit, nor ours without their description."""
    source = exported(tmp_path / "out", SensorTask.force)
    export(simulated(SensorTask.force), tmp_path / "out", workers=1)
    assert source.catalogue().units == ("N", "N", "N")
    forces = tmp_path / "out" / "Force_Regression"
    shutil.copytree(forces / SIMULATED_SENSOR, forces / "Real")
    (forces / "Real" / f"{SIMULATED_SENSOR}.csv").rename(forces / "Real" / "Real.csv")
    assert replace(source, sensor="Real").catalogue().units is None
    for text in ("no JSON", "[]", '{"source": "measured", "task": "force"}', '{"source": "simulated"}'):
        (tmp_path / "out" / SIMULATION).write_text(text)
        assert source.catalogue().units is None
    (tmp_path / "out" / SIMULATION).unlink()
    assert source.catalogue().units is None


def test_every_bit_of_a_label_survives(tmp_path: Path) -> None:
    """The table holds the labels as Python writes floats, which is exact."""
    source = simulated(SensorTask.force)
    export(source, tmp_path / "out", workers=1)
    with (tmp_path / "out" / "Force_Regression" / SIMULATED_SENSOR / f"{SIMULATED_SENSOR}.csv").open() as file:
        header, *rows = csv.reader(file)
    assert header == ["image_name", "fx", "fy", "fz"]
    assert np.array_equal([[float(text) for text in row[1:]] for row in rows], source.catalogue().labels)


def test_gratings_are_named_after_their_size(tmp_path: Path) -> None:
    """Each press is a group of one frame, and no size loses a digit or becomes an exponent."""
    source = simulated(SensorTask.grating, images=20, spacings=(0.00001, 1.1000000000000001, 2.0))
    export(source, tmp_path / "out", workers=1)
    names = {path.name for path in (tmp_path / "out" / "Grating_Classification" / SIMULATED_SENSOR / PATTERN).iterdir()}
    assert len(names) == 20
    assert {"0.00001_00001_1.png", "1.1_00007_1.png", "2_00006_1.png"} <= names


def test_export_says_what_it_is(tmp_path: Path) -> None:
    """Parameters and a command that reads the directory lie beside the images."""
    source = simulated(SensorTask.grating)
    export(source, tmp_path / "out", workers=1)
    assert json.loads((tmp_path / "out" / "simulation.json").read_text()) == source.describe()
    text = (tmp_path / "out" / "README.md").read_text()
    assert "data=tacverse data.root=out data.sensor=SimViTacTip data.pattern=Ridges task.outputs=2" in text


def test_workers_change_no_byte(tmp_path: Path) -> None:
    """Two processes write the files of one."""
    source = simulated(SensorTask.force, images=FEW_PICTURES + 40)  # more than one process from there on
    for workers in (1, 2):
        assert export(source, tmp_path / "out", workers=workers) == FEW_PICTURES + 40
        (tmp_path / "out").rename(tmp_path / str(workers))
    files = [sorted(path for path in (tmp_path / str(number)).rglob("*") if path.is_file()) for number in (1, 2)]
    assert len(files[0]) == FEW_PICTURES + 43
    assert [file.read_bytes() for file in files[0]] == [file.read_bytes() for file in files[1]]


def test_progress_counts_up_to_all_images(tmp_path: Path) -> None:
    """Progress is told per chunk and ends with everything done."""
    seen: list[tuple[int, int]] = []
    source = simulated(SensorTask.force, images=40)
    export(source, tmp_path / "out", workers=1, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(32, 40), (40, 40)]


def stop(done: int, total: int) -> NoReturn:
    """Interrupt as Ctrl-C does."""
    raise KeyboardInterrupt


def test_interrupted_export_leaves_nothing(tmp_path: Path) -> None:
    """Neither the directory nor a hidden part of it."""
    with pytest.raises(KeyboardInterrupt):
        export(simulated(SensorTask.force), tmp_path / "out", workers=1, progress=stop)
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
        export(simulated(SensorTask.force), tmp_path / "out", workers=1)
    assert [path.read_text() for path in tmp_path.rglob("*") if path.is_file()] == ["mine"]


@pytest.mark.parametrize("out", [".", "./", "made/.."])
def test_current_folder_is_refused_before_anything_is_drawn(
    out: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is empty, but to replace it would take the ground from under the user's shell."""
    monkeypatch.chdir(tmp_path)
    seen: list[tuple[int, int]] = []
    with refused(DataError, place="out", expected="a new directory", got="the current directory"):
        export(simulated(SensorTask.force), Path(out), workers=1, progress=lambda *told: seen.append(told))
    assert (seen, list(tmp_path.iterdir())) == ([], [])


def test_link_to_an_empty_folder_is_followed(tmp_path: Path) -> None:
    """The directory behind it is filled, and the link stays."""
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    export(simulated(SensorTask.force), tmp_path / "out", workers=1)
    assert (tmp_path / "out").is_symlink()
    assert (tmp_path / "disk" / SIMULATION).is_file()


def test_folder_that_is_filled_meanwhile_is_kept(tmp_path: Path) -> None:
    """The process that is first keeps the name."""
    out = tmp_path / "out"
    source = simulated(SensorTask.force)
    with pytest.raises(OSError, match="not empty"):
        export(source, out, workers=1, progress=lambda done, total: fill(out) if done == total else None)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert [path.name for path in out.iterdir()] == ["mine.txt"]


def test_empty_folder_is_filled(tmp_path: Path) -> None:
    """A directory that exists and is empty is used."""
    (tmp_path / "out").mkdir()
    export(simulated(SensorTask.force), tmp_path / "out", workers=1)
    assert (tmp_path / "out" / "simulation.json").is_file()


def test_gratings_out_of_order_are_refused(tmp_path: Path) -> None:
    """Classes are read back in the order of their sizes, so any other order would change the labels."""
    with refused(ConfigError, place="data.spacings_mm", expected="ascending order", got="[2.0, 0.5]"):
        export(simulated(SensorTask.grating, spacings=(2.0, 0.5)), tmp_path / "out", workers=1)
