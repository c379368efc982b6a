"""The survey of a finished data set: what a person wants to know of it before a search.

Nothing of it reaches a training; the test split may be looked at. Of images that are nearly equal, frames whose light
or position changes are not found, nor all of a large data set.
"""

import hashlib
from collections import defaultdict
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pandas as pd

from tacevo.data.dataset import Dataset
from tacevo.data.labels import labels_of, plain_name
from tacevo.data.splitting import PARTS
from tacevo.records import Kind

#: Images are compared as grey thumbnails of so many pixels a side: finer grain is noise.
SIDE = 16

#: Two images are nearly equal where their mean squared difference is less than one part in so many of that of two
#: images of the training split, on average. Of 3,000 simulated presses, at most one is that near to another.
ALIKE = 200

#: The largest number of images of a part that are compared, at even steps.
_MOST = 10_000


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


def nearly_equal(dataset: Dataset) -> tuple[tuple[int, int], ...]:
    """Find the validation and test images that are nearly equal, but not equal, to an image of an earlier part.

    The parts are in the order training, validation, test.

    Returns:
        Each such row, ascending, with the row that it is nearest to.
    """
    from sklearn.metrics import pairwise_distances_argmin_min  # a second to import, for recordings only

    images: npt.NDArray[np.uint8] = np.load(dataset.images, mmap_mode="r")
    parts = [rows[:: -(-len(rows) // _MOST)] for rows in (dataset.train, dataset.validation, dataset.test)]
    rows, ends = np.concatenate(parts), np.cumsum([len(part) for part in parts]).tolist()
    thumbnails = np.array([_thumbnail(images[row]) for row in rows])
    thumbnails -= thumbnails[: ends[0]].mean(axis=0)
    limit = 2 * float((thumbnails[: ends[0]] ** 2).sum(axis=1).mean()) / ALIKE
    pairs: list[tuple[int, int]] = []
    for start, end in pairwise(ends):
        nearest, distances = pairwise_distances_argmin_min(thumbnails[start:end], thumbnails[:start])
        alike = distances**2 < limit
        pairs += zip(rows[start:end][alike].tolist(), rows[nearest[alike]].tolist(), strict=True)
    return tuple(sorted((row, other) for row, other in pairs if (images[row] != images[other]).any()))


def _thumbnail(image: npt.NDArray[np.uint8]) -> npt.NDArray[np.float64]:
    """Average an image to a grey thumbnail, shape (SIDE * SIDE,), in units of the pixel values 0 to 255."""
    edges = np.linspace(0, image.shape[-1], SIDE + 1).astype(np.int64)
    grey = image.sum(axis=0, dtype=np.int64)
    sums = np.add.reduceat(np.add.reduceat(grey, edges[:-1], axis=0), edges[:-1], axis=1)
    areas = np.outer(np.diff(edges), np.diff(edges)) * len(image)
    return np.ravel(sums / areas)
