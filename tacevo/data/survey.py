"""What a finished data set holds, counted: what a person wants to know of it before a search.

Nothing that is found here reaches a training; the test split may be looked at.
"""

import hashlib
from collections import defaultdict

import numpy as np
import numpy.typing as npt
import pandas as pd

from tacevo.data.dataset import Dataset
from tacevo.data.labels import labels_of, plain_name
from tacevo.data.splitting import PARTS
from tacevo.records import Kind


def split_of(dataset: Dataset) -> tuple[str, ...]:
    """Name the split of every row."""
    names = np.empty(len(dataset.targets), dtype=object)
    for part in PARTS:
        names[getattr(dataset, part)] = part
    return tuple(names)


def label_table(dataset: Dataset, units: tuple[str, ...]) -> pd.DataFrame:
    """Describe the labels of every part.

    Returns:
        Regression: `output`, `part`, and `min`, `max`, `mean` and (population) `deviation` in the unit of the
        recording. Classification: `class`, and how many images each part has of it.
    """
    labels, names = labels_of(dataset), dataset.facts.names
    rows_of = {part: getattr(dataset, part) for part in PARTS}
    if dataset.facts.kind is Kind.classification:
        numbers = labels[:, 0].astype(np.int64)
        counts = {part: np.bincount(numbers[rows], minlength=len(names)) for part, rows in rows_of.items()}
        return pd.DataFrame({"class": names, **counts})
    ranges = []
    for name, unit, column in zip(names, units, labels.T, strict=True):
        title = f"{plain_name(name, unit)} [{unit or 'unit unknown'}]"
        for part, rows in rows_of.items():
            values = column[rows]
            ranges.append([title, part, values.min(), values.max(), values.mean(), values.std()])
    return pd.DataFrame(ranges, columns=["output", "part", "min", "max", "mean", "deviation"])


def equal_images(images: npt.NDArray[np.uint8]) -> tuple[tuple[int, ...], ...]:
    """Find the rows of images with equal pixels (by their SHA-256); each group, and the groups, in row order."""
    groups: defaultdict[bytes, list[int]] = defaultdict(list)
    for row, image in enumerate(images):
        groups[hashlib.sha256(image.tobytes()).digest()].append(row)
    return tuple(tuple(rows) for rows in groups.values() if len(rows) > 1)


def constant_images(images: npt.NDArray[np.uint8]) -> tuple[int, ...]:
    """Find the rows, ascending, whose image has one value per channel."""
    return tuple(row for row, image in enumerate(images) if (image == image[:, :1, :1]).all())
