"""What a finished data set holds, counted: what a person wants to know of it before a search.

Nothing that is found here reaches a training; the test split may be looked at.
"""

import hashlib
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from tacevo.choices import Normalisation
from tacevo.data.dataset import Dataset
from tacevo.data.labels import labels_of, plain_name
from tacevo.data.scaling import input_statistics
from tacevo.records import Kind

PARTS = ("train", "validation", "test")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Survey:
    """What `survey` counts."""

    #: Regression: `output`, `part`, and `min`, `max`, `mean` and (population) `deviation` in the unit of the recording.
    #: Classification: `class`, and how many images each part has of it.
    labels: pd.DataFrame
    #: Of the training split, per channel, in units of the pixel values 0 to 255.
    mean: tuple[float, ...]
    #: As `mean`; 1 for a channel that never changes.
    deviation: tuple[float, ...]
    #: Rows of images with equal pixels, at the size that is trained with; each group, and the groups, in row order.
    equal: tuple[tuple[int, ...], ...]
    #: Rows whose image has one value per channel, ascending.
    constant: tuple[int, ...]


def survey(dataset: Dataset, units: tuple[str, ...]) -> Survey:
    """Count a data set; reads every training image three times and every other one twice."""
    images: npt.NDArray[np.uint8] = np.load(dataset.images, mmap_mode="r")
    mean, deviation = input_statistics(images, dataset.train, Normalisation.standardise)
    is_regression = dataset.facts.kind is Kind.regression
    return Survey(
        labels=_ranges(dataset, units) if is_regression else _classes(dataset),
        mean=mean,
        deviation=deviation,
        equal=_equal(images),
        constant=tuple(row for row, image in enumerate(images) if (image == image[:, :1, :1]).all()),
    )


def split_of(dataset: Dataset) -> tuple[str, ...]:
    """Name the split of every row."""
    names = np.empty(len(dataset.targets), dtype=object)
    for part in PARTS:
        names[getattr(dataset, part)] = part
    return tuple(names)


def _ranges(dataset: Dataset, units: tuple[str, ...]) -> pd.DataFrame:
    """Describe the values of every output in every part."""
    titles = [
        f"{plain_name(name, unit)} [{unit or 'unit unknown'}]"
        for name, unit in zip(dataset.facts.names, units, strict=True)
    ]
    rows = []
    for title, column in zip(titles, labels_of(dataset).T, strict=True):
        for part in PARTS:
            values = column[getattr(dataset, part)]
            rows.append([title, part, values.min(), values.max(), values.mean(), values.std()])
    return pd.DataFrame(rows, columns=["output", "part", "min", "max", "mean", "deviation"])


def _classes(dataset: Dataset) -> pd.DataFrame:
    """Count the images of every class in every part."""
    names, numbers = dataset.facts.names, labels_of(dataset)[:, 0].astype(np.int64)
    counts = {part: np.bincount(numbers[getattr(dataset, part)], minlength=len(names)) for part in PARTS}
    return pd.DataFrame({"class": names, **counts})


def _equal(images: npt.NDArray[np.uint8]) -> tuple[tuple[int, ...], ...]:
    """Group equal images by the SHA-256 of their pixels."""
    groups: defaultdict[bytes, list[int]] = defaultdict(list)
    for row, image in enumerate(images):
        groups[hashlib.sha256(image.tobytes()).digest()].append(row)
    return tuple(tuple(rows) for rows in groups.values() if len(rows) > 1)
