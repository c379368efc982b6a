"""Loading: made once, whole or absent in the cache, independent of workers, and blind to the test split."""

import subprocess
import sys
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NoReturn

import numpy as np
import numpy.typing as npt
import pytest

from tacevo.choices import Normalisation, TargetScaling
from tacevo.data.dataset import Dataset, fingerprint
from tacevo.data.loading import FEW_PICTURES, assemble, load
from tacevo.data.simulator import Simulated, SimulatedTask
from tacevo.data.source import Catalogue, Picture, Source
from tacevo.errors import DataError
from tacevo.records import Json, Kind

REPOSITORY = Path(__file__).parent.parent


def grey(value: int) -> Picture:
    """Make a picture of one grey value."""
    return np.full((3, 4, 4), value, dtype=np.uint8)


def broken(name: str) -> Picture:
    """Fail as a damaged image file does."""
    raise DataError(name)


@dataclass(frozen=True)
class Greys:
    """A source of grey pictures whose label is their grey value."""

    count: int = 20
    kind: Kind = Kind.regression
    names: tuple[str, ...] = ("grey",)
    broken: int = 0

    def describe(self) -> Json:
        """Name the content."""
        return {"source": "greys", "count": self.count, "broken": self.broken}

    def catalogue(self) -> Catalogue:
        """List the pictures; the first few may be broken."""
        good = [partial(grey, value % 256) for value in range(self.broken, self.count)]
        return Catalogue(
            kind=self.kind,
            names=self.names,
            labels=np.arange(self.count, dtype=np.float64).reshape(-1, 1),
            image_size=4,
            pictures=[*[partial(broken, f"{number}.png") for number in range(self.broken)], *good],
        )


@dataclass(frozen=True)
class Undecodable(Greys):
    """A source that can be described but no longer listed."""

    def catalogue(self) -> NoReturn:
        """Fail, because nothing may be decoded any more."""
        raise AssertionError("the cache was not used")


def load_greys(source: Source, cache: Path, *, split_seed: int = 0, workers: int = 1) -> Dataset:
    """Load with the default protocol."""
    return load(
        source,
        split_seed=split_seed,
        normalisation=Normalisation.standardise,
        target_scaling=TargetScaling.minmax,
        cache=cache,
        workers=workers,
    )


def test_loaded_data_set_keeps_its_promises(tmp_path: Path) -> None:
    """Pixels, targets, counts and names are those of the source."""
    dataset = load_greys(Greys(), tmp_path)
    images = np.load(dataset.images, mmap_mode="r")
    assert images.shape == (20, 3, 4, 4)
    assert images.dtype == np.uint8
    assert images[:, 0, 0, 0].tolist() == list(range(20))
    assert dataset.targets.shape == (20, 1)
    assert dataset.targets.dtype == np.float32
    labels = dataset.targets[:, 0] * dataset.scale[0] + dataset.offset[0]
    assert labels == pytest.approx(np.arange(20), abs=1e-5)
    assert dataset.facts.counts == (16, 2, 2)
    assert (dataset.facts.outputs, dataset.facts.names, dataset.facts.in_channels) == (1, ("grey",), 3)
    assert dataset.facts.fingerprint == fingerprint(dataset)


def test_minmax_targets_of_the_training_split_fill_0_to_1(tmp_path: Path) -> None:
    """The smallest training label becomes 0 and the largest 1."""
    dataset = load_greys(Greys(), tmp_path)
    training = dataset.targets[dataset.train]
    assert (training.min(), training.max()) == (0.0, 1.0)


def test_second_load_decodes_nothing(tmp_path: Path) -> None:
    """The cache answers for an equal description."""
    first = load_greys(Greys(), tmp_path)
    second = load_greys(Undecodable(), tmp_path)
    assert second.facts == first.facts
    assert np.array_equal(second.targets, first.targets)


@pytest.mark.parametrize("other", ["source", "split_seed", "normalisation", "target_scaling"])
def test_everything_that_decides_the_content_makes_another_entry(tmp_path: Path, other: str) -> None:
    """Two settings that give different data never share a cache entry, and differ in their fingerprint."""
    chosen = {
        "source": Greys(),
        "split_seed": 0,
        "normalisation": Normalisation.standardise,
        "target_scaling": TargetScaling.minmax,
    }
    changed = {
        "source": Greys(count=21),
        "split_seed": 1,
        "normalisation": Normalisation.unit,
        "target_scaling": TargetScaling.zscore,
    }
    first = load(**chosen, cache=tmp_path, workers=1)  # type: ignore[arg-type]
    second = load(**{**chosen, other: changed[other]}, cache=tmp_path, workers=1)  # type: ignore[arg-type]
    assert first.images != second.images
    assert first.facts.fingerprint != second.facts.fingerprint


def test_workers_change_no_byte(tmp_path: Path) -> None:
    """One process and two processes give the same fingerprint."""
    source = Simulated(
        task=SimulatedTask.force, images=FEW_PICTURES + 50, image_size=16, seed=3, spacings_mm=()
    )  # more than one process is used only above FEW_PICTURES
    alone = load_greys(source, tmp_path / "one", workers=1)
    together = load_greys(source, tmp_path / "two", workers=2)
    assert alone.facts == together.facts


def test_test_split_influences_nothing_but_the_fingerprint(tmp_path: Path) -> None:
    """Other test images and labels leave every statistic and every other target as they were."""
    catalogue = Greys().catalogue()
    pixels = np.stack([picture() for picture in catalogue.pictures])
    before = assemble_arrays(tmp_path / "before.npy", catalogue, pixels)
    pixels[before.test] = 255
    labels = catalogue.labels.copy()
    labels[before.test] = 1e6
    after = assemble_arrays(tmp_path / "after.npy", replace(catalogue, labels=labels), pixels)
    for name in ("mean", "deviation", "offset", "scale"):
        assert getattr(after, name) == getattr(before, name)
    for rows in (before.train, before.validation):
        assert np.array_equal(after.targets[rows], before.targets[rows])
    assert np.array_equal(after.train, before.train)
    assert after.facts.fingerprint != before.facts.fingerprint


def assemble_arrays(path: Path, catalogue: Catalogue, pixels: npt.NDArray[np.uint8]) -> Dataset:
    """Apply the default protocol to arrays."""
    np.save(path, pixels)
    return assemble(catalogue, path, 0, Normalisation.standardise, TargetScaling.minmax)


def test_progress_counts_up_to_all_pictures(tmp_path: Path) -> None:
    """Progress is told per chunk and ends with everything done."""
    seen: list[tuple[int, int]] = []
    load(
        Greys(count=70),
        split_seed=0,
        normalisation=Normalisation.unit,
        target_scaling=TargetScaling.none,
        cache=tmp_path,
        workers=1,
        progress=lambda done, total: seen.append((done, total)),
    )
    assert seen == [(32, 70), (64, 70), (70, 70)]


def test_unreadable_images_are_counted_and_leave_no_entry(tmp_path: Path) -> None:
    """All faults are collected, the first few are named, and nothing is cached."""
    with pytest.raises(DataError, match=r"7 found\): 0.png, 1.png, 2.png, 3.png, 4.png, \.\.\."):
        load_greys(Greys(broken=7), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_fewer_than_ten_images_are_refused(tmp_path: Path) -> None:
    """Nine images cannot be split into three parts of the protocol."""
    with pytest.raises(DataError, match=r"at least 10 images.*got 9"):
        load_greys(Greys(count=9), tmp_path)


def test_single_class_is_refused(tmp_path: Path) -> None:
    """There is nothing to tell apart."""
    with pytest.raises(DataError, match=r"at least two classes; got only \['flat'\]"):
        load_greys(Greys(kind=Kind.classification, names=("flat",)), tmp_path)


LOAD_IN_A_PROCESS = """
import os, signal, sys
from pathlib import Path
from tacevo.config import Normalisation, TargetScaling
from tacevo.data.loading import load
from tacevo.data.simulator import Simulated, SimulatedTask

def progress(done, total):
    if sys.argv[2] == "die" and done > total / 2:
        os.kill(os.getpid(), signal.SIGKILL)

source = Simulated(task=SimulatedTask.force, images=300, image_size=16, seed=0, spacings_mm=())
dataset = load(source, split_seed=0, normalisation=Normalisation.unit, target_scaling=TargetScaling.minmax,
               cache=Path(sys.argv[1]), workers=1, progress=progress)
print(dataset.facts.fingerprint)
"""


def start(cache: Path, fate: str) -> subprocess.Popen[str]:
    """Start a process that loads a simulated data set, or dies half-way."""
    command = [sys.executable, "-c", LOAD_IN_A_PROCESS, str(cache), fate]
    return subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True)


def entries(cache: Path) -> list[Path]:
    """List what a reader of the cache can see."""
    return [path for path in cache.iterdir() if not path.name.startswith(".")]


def test_killed_process_leaves_no_entry(tmp_path: Path) -> None:
    """After a kill half-way the entry is absent, and the next process makes it."""
    killed = start(tmp_path, "die")
    killed.communicate()
    assert killed.returncode == -9
    assert entries(tmp_path) == []
    output, _ = start(tmp_path, "live").communicate()
    assert len(output.strip()) == 64


def test_processes_that_start_at_once_share_one_entry(tmp_path: Path) -> None:
    """Both finish, with the same data, and one entry remains."""
    outputs = [process.communicate()[0] for process in [start(tmp_path, "live"), start(tmp_path, "live")]]
    assert outputs[0] == outputs[1]
    assert len(outputs[0].strip()) == 64
    assert [path.is_dir() for path in tmp_path.iterdir()] == [True]
