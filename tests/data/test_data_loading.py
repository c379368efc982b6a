"""Loading: made once, independent of workers, blind to the test split, and no image decoded before a fault is told."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
from greys import Greys, entries
from refusals import refused
from small_recordings import (
    in_rooms,
    loaded,
    save_arrays,
    save_folder,
    save_forces,
    save_gratings,
    save_table,
    simulated,
)
from tests_own import Touches

from tacevo.choices import Normalisation, SensorTask, SplitRule, TargetScaling
from tacevo.data.dataset import STATISTICS, fingerprint
from tacevo.data.loading import split_rows
from tacevo.errors import ConfigError, DataError, TacevoError
from tacevo.parts.source import Catalogue, Source
from tacevo.records import Json, Kind


@dataclass(frozen=True)
class Undecodable(Greys):
    """A source that can be described but no longer listed."""

    def catalogue(self) -> NoReturn:
        """Fail, because nothing may be decoded any more."""
        raise AssertionError("the cache was not used")


def test_loaded_data_set_keeps_its_promises(tmp_path: Path) -> None:
    """Pixels, targets, counts and names are those of the source."""
    dataset = loaded(Greys(), tmp_path)
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


def test_second_load_decodes_nothing(tmp_path: Path) -> None:
    """The cache answers for an equal description."""
    first = loaded(Greys(), tmp_path)
    second = loaded(Undecodable(), tmp_path)
    assert second.facts == first.facts
    assert np.array_equal(second.targets, first.targets)


def test_catalogue_that_is_given_is_not_listed_again(tmp_path: Path) -> None:
    """Who has looked at a source's catalogue hands it over; listing it twice would read a recording twice."""
    assert loaded(Undecodable(), tmp_path, catalogue=Greys().catalogue()).facts.counts == (16, 2, 2)


@pytest.mark.parametrize(
    "change",
    [
        {"source": Greys(count=21, released=True)},
        {"split": SplitRule.release},
        {"split_seed": 1},
        {"held_out": (0.2, 0.1)},
        {"normalisation": Normalisation.unit},
        {"target_scaling": TargetScaling.zscore},
    ],
    ids=str,
)
def test_everything_that_decides_the_content_makes_another_entry(tmp_path: Path, change: dict[str, Any]) -> None:
    """Two settings that give different data never share a cache entry, and differ in their fingerprint."""
    chosen: dict[str, Any] = {"source": Greys(released=True), "cache": tmp_path}
    first, second = loaded(**chosen), loaded(**{**chosen, **change})
    assert first.images != second.images
    assert first.facts.fingerprint != second.facts.fingerprint


def test_workers_change_no_byte(tmp_path: Path) -> None:
    """One thread and several give the same fingerprint."""
    source = Touches(images=100, image_size=16, seed=3)
    assert loaded(source, tmp_path / "one", workers=1).facts == loaded(source, tmp_path / "two", workers=3).facts


@dataclass(frozen=True)
class Spoilt:
    """A source whose rows outside the training split have white pictures and, for regression, huge labels."""

    source: Source
    rows: tuple[int, ...]

    def describe(self) -> Json:
        """Name the content."""
        return {"spoilt": list(self.rows), "source": self.source.describe()}

    def catalogue(self) -> Catalogue:
        """Replace what training must not see."""
        catalogue = self.source.catalogue()
        pictures = list(catalogue.pictures)
        labels = catalogue.labels.copy()
        for row in self.rows:
            pictures[row] = partial(np.full, (3, catalogue.image_size, catalogue.image_size), 255, dtype=np.uint8)
            if catalogue.kind is Kind.regression:
                labels[row] = 1e6 + row
        return replace(catalogue, pictures=pictures, labels=labels)


def values(first: int, count: int) -> str:
    """Write three different columns of labels."""
    return ",".join(str((first * step) % count) for step in (1, 3, 7))


#: One source of each form, with the split that it is loaded by.
SOURCES: dict[str, Callable[[Path], tuple[Source, SplitRule]]] = {
    "simulated force": lambda root: (simulated(images=20), SplitRule.random),
    "simulated grating": lambda root: (simulated(SensorTask.grating, images=45), SplitRule.random),
    "csv": lambda root: (
        save_table(root, "".join(f"{n}.png,{values(n, 20)}\n" for n in range(20)), images=20),
        SplitRule.random,
    ),
    "folder": lambda root: (save_folder(root, *(f"{n % 2}/{n}.png" for n in range(40))), SplitRule.random),
    "tacverse force": lambda root: (
        save_forces(root, "".join(f"image_{n}.png,{values(n, 20)}\n" for n in range(20)), images=20),
        SplitRule.release,
    ),
    "tacverse grating": lambda root: (
        save_gratings(root, *(f"{size}_{group}.png" for size in (0.5, 1.0) for group in range(10))),
        SplitRule.release,
    ),
    "numpy": lambda root: (
        save_arrays(
            root / "set.npz",
            groups=np.arange(12) // 3,
            images=np.eye(12 * 16, dtype=np.uint8)[:, :16].reshape(12, 16, 16),
        ),
        SplitRule.random,
    ),
}


@pytest.mark.few(5)
@pytest.mark.parametrize("scaling", [TargetScaling.minmax, TargetScaling.zscore])
@pytest.mark.parametrize("form", in_rooms(SOURCES))
def test_only_the_training_split_decides_the_statistics(tmp_path: Path, form: str, scaling: TargetScaling) -> None:
    """Other validation and test images and labels change the fingerprint alone; one training picture more."""
    source, rule = SOURCES[form](tmp_path / "recording")
    how: dict[str, Any] = {"cache": tmp_path / "cache", "split": rule, "target_scaling": scaling}
    before = loaded(source, **how)
    after = loaded(Spoilt(source, (*before.validation.tolist(), *before.test.tolist())), **how)
    assert [getattr(after, name) for name in STATISTICS] == [getattr(before, name) for name in STATISTICS]
    assert np.array_equal(after.train, before.train)
    assert np.array_equal(after.targets[after.train], before.targets[before.train])
    assert after.facts.fingerprint != before.facts.fingerprint
    assert before.mean == pytest.approx(np.load(before.images)[before.train].mean(axis=(0, 2, 3)))
    assert loaded(Spoilt(source, (int(before.train[0]),)), **how).mean != before.mean


def test_release_names_its_own_parts(tmp_path: Path) -> None:
    """`release` takes the parts from the source, for every seed; where it names none there are none to take."""
    dataset = loaded(Greys(released=True), tmp_path, split=SplitRule.release)
    assert dataset.facts.counts == (12, 4, 4)
    assert dataset.test.tolist() == [16, 17, 18, 19]
    with refused(DataError, place="data.split", got="release", remedy="set data.split=random"):
        loaded(Greys(), tmp_path / "other", split=SplitRule.release)


def test_progress_counts_up_to_all_pictures(tmp_path: Path) -> None:
    """Progress is told per chunk and ends with everything done."""
    seen: list[tuple[int, int]] = []
    loaded(Greys(count=70), tmp_path, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(32, 70), (64, 70), (70, 70)]


def test_unreadable_images_are_counted_and_leave_no_entry(tmp_path: Path) -> None:
    """All faults are collected, the first few are named, nothing is cached, and progress does not reach the end."""
    seen: list[tuple[int, int]] = []
    shown = ", ".join(f"row {number} ({number}.png)" for number in range(5))
    with refused(DataError, got=f"(7 found): {shown}, ..."):
        loaded(Greys(broken=7), tmp_path, progress=lambda done, total: seen.append((done, total)))
    assert entries(tmp_path) == []
    assert seen == []


def refuse_all(catalogue: Catalogue) -> None:
    """Accept no data set."""
    raise ConfigError(f"no {catalogue.names[0]}, please")


@pytest.mark.parametrize(
    ("source", "accept", "kind", "fields"),
    [
        (Greys(broken=20), refuse_all, ConfigError, {"got": "no grey, please"}),
        (Greys(broken=20, step=0.0), None, DataError, {"place": "label grey", "got": "one value"}),
        (Greys(broken=20, groups=(0, 1) * 10), None, DataError, {"expected": "at least 3 groups"}),
        (Greys(broken=9, count=9), None, DataError, {"expected": "at least 10 images"}),
        (Greys(broken=20, kind=Kind.classification), None, DataError, {"expected": "at least two classes"}),
        (
            Greys(broken=20, kind=Kind.classification, names=tuple("abcdefghijkl")),
            None,
            DataError,
            {"got": "no images of"},
        ),
    ],
    ids=["task", "constant target", "groups", "too few", "one class", "absent class"],
)
def test_what_needs_no_decoding_is_told_first(
    tmp_path: Path,
    source: Source,
    accept: Callable[[Catalogue], None] | None,
    kind: type[TacevoError],
    fields: dict[str, str],
) -> None:
    """Every image is broken too, but the fault that needs no decoding is the one that is told."""
    with refused(kind, **fields):
        loaded(source, tmp_path, accept=accept)


BEYOND, FAR = "some labels are beyond 1e+30 in size", "some labels are too far from those of the training split"


@pytest.mark.parametrize(
    ("part", "step", "label", "got"),
    [
        *((part, 1.0, 1e33, BEYOND) for part in ("train", "validation", "test")),
        *((part, 1e-12, 1e30, FAR) for part in ("validation", "test")),
    ],
)
def test_labels_beyond_all_measure_are_named_by_row(
    tmp_path: Path, part: str, step: float, label: float, got: str
) -> None:
    """In training sums of squares would overflow; elsewhere a slip would pass for a huge error, or for infinity."""
    source = Greys(step=step)
    row = int(getattr(split_rows(source.catalogue(), SplitRule.random, 0), part)[0])
    with refused(DataError, got=got) as caught:
        loaded(Mislabelled(source, row, label), tmp_path)
    assert f"(1 found): row {row} [{label:g}]" in caught.value.got


@dataclass(frozen=True)
class Mislabelled:
    """A source in which one row has another label."""

    source: Source
    row: int
    label: float

    def describe(self) -> Json:
        """Name the content."""
        return {"row": self.row, "label": self.label, "source": self.source.describe()}

    def catalogue(self) -> Catalogue:
        """Replace the label."""
        catalogue = self.source.catalogue()
        labels = catalogue.labels.copy()
        labels[self.row] = self.label
        return replace(catalogue, labels=labels)
