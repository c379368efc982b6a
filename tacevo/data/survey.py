"""What a finished data set holds, counted: what a person wants to know of it before a search.

Nothing that is found here reaches a training; the test split may be looked at.
"""

import hashlib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tacevo.choices import Normalisation
from tacevo.data.dataset import Dataset
from tacevo.data.labels import labels_of
from tacevo.data.scaling import input_statistics
from tacevo.records import Kind


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """How the values of one output are spread over a split, in the unit of the recording."""

    name: str
    #: Empty where it is not known.
    unit: str
    minimum: float
    maximum: float
    mean: float
    #: Population standard deviation.
    deviation: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """One split."""

    #: `train`, `validation` or `test`.
    name: str
    images: int
    #: Regression: one entry an output; else empty.
    ranges: tuple[Range, ...]
    #: Classification: images of each class, in the order of the outputs; else empty.
    classes: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Duplicates:
    """Images with equal pixels."""

    #: Row numbers, ascending, at least two.
    rows: tuple[int, ...]
    #: The split of each row.
    parts: tuple[str, ...]

    @property
    def leak(self) -> bool:
        """Whether they straddle splits, so that a network is tested on what it has learnt."""
        return len(set(self.parts)) > 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Survey:
    """What `survey` counts."""

    parts: tuple[Part, ...]
    #: Of the training split, per channel, in units of the pixel values 0 to 255.
    mean: tuple[float, ...]
    #: As `mean`; 1 for a channel that never changes.
    deviation: tuple[float, ...]
    #: Groups of equal images, at the size that is trained with; in the order of their first row.
    duplicates: tuple[Duplicates, ...]
    #: Rows whose image has one value per channel, ascending.
    constant: tuple[int, ...]

    @property
    def leaks(self) -> tuple[Duplicates, ...]:
        """Groups of equal images that straddle splits."""
        return tuple(group for group in self.duplicates if group.leak)


def survey(dataset: Dataset, units: tuple[str, ...]) -> Survey:
    """Count a data set; reads every training image three times and every other one twice."""
    images: npt.NDArray[np.uint8] = np.load(dataset.images, mmap_mode="r")
    mean, deviation = input_statistics(images, dataset.train, Normalisation.standardise)
    return Survey(
        parts=tuple(_part(dataset, units, name, rows) for name, rows in _splits(dataset)),
        mean=mean,
        deviation=deviation,
        duplicates=_duplicates(images, split_of(dataset)),
        constant=tuple(row for row, image in enumerate(images) if (image == image[:, :1, :1]).all()),
    )


def split_of(dataset: Dataset) -> tuple[str, ...]:
    """Name the split of every row."""
    names = np.empty(len(dataset.targets), dtype=object)
    for name, rows in _splits(dataset):
        names[rows] = name
    return tuple(names)


def _splits(dataset: Dataset) -> Iterator[tuple[str, npt.NDArray[np.int64]]]:
    for name in ("train", "validation", "test"):
        yield name, getattr(dataset, name)


def _part(dataset: Dataset, units: tuple[str, ...], name: str, rows: npt.NDArray[np.int64]) -> Part:
    """Describe the labels of one split."""
    labels, names = labels_of(dataset)[rows], dataset.facts.names
    if dataset.facts.kind is Kind.classification:
        counts = np.bincount(labels[:, 0].astype(np.int64), minlength=len(names))
        return Part(name=name, images=len(rows), ranges=(), classes=tuple(counts.tolist()))
    ranges = map(_range, names, units, labels.T)
    return Part(name=name, images=len(rows), ranges=tuple(ranges), classes=())


def _range(name: str, unit: str, values: npt.NDArray[np.float64]) -> Range:
    low, high, mean, deviation = (float(value) for value in (values.min(), values.max(), values.mean(), values.std()))
    return Range(name=name, unit=unit, minimum=low, maximum=high, mean=mean, deviation=deviation)


def _duplicates(images: npt.NDArray[np.uint8], splits: tuple[str, ...]) -> tuple[Duplicates, ...]:
    """Group equal images by the SHA-256 of their pixels."""
    groups: defaultdict[bytes, list[int]] = defaultdict(list)
    for row, image in enumerate(images):
        groups[hashlib.sha256(image.tobytes()).digest()].append(row)
    return tuple(
        Duplicates(rows=tuple(rows), parts=tuple(splits[row] for row in rows))
        for rows in groups.values()
        if len(rows) > 1
    )
