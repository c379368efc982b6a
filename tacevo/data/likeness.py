"""Images that are nearly equal and stand in two parts of a split, as frames of one press do.

What it does not promise: frames whose light or position changes are not found, nor all of a large data set.
"""

import numpy as np
import numpy.typing as npt

from tacevo.data.dataset import Dataset

#: Images are compared as grey thumbnails of so many pixels a side: finer grain is noise.
SIDE = 16

#: Two images are nearly equal where their mean squared difference is less than one part in so many of that of two
#: images of the training split, on average. Of 3,000 simulated presses, at most one is that near to another.
ALIKE = 200

#: Most images that are compared of a part, at even steps, and how many of them at once.
_MOST, _BLOCK = 10_000, 256

#: Row numbers.
_Rows = npt.NDArray[np.int64]


def nearly_equal(dataset: Dataset) -> tuple[tuple[int, int], ...]:
    """Find the validation and test images that are nearly equal, but not equal, to an image of an earlier part.

    The parts are in the order training, validation, test.

    Returns:
        Each such row, ascending, with the row that it is nearest to.
    """
    images: npt.NDArray[np.uint8] = np.load(dataset.images, mmap_mode="r")
    parts = [rows[:: -(-len(rows) // _MOST)] for rows in (dataset.train, dataset.validation, dataset.test)]
    thumbnails = [_thumbnails(images, rows) for rows in parts]
    middle = thumbnails[0].mean(axis=0)
    train, validation, test = (found - middle for found in thumbnails)
    limit = 2 * float((train**2).sum(axis=1).mean()) / ALIKE
    found = _pairs(validation, parts[1], train, parts[0], limit)
    found += _pairs(test, parts[2], np.concatenate([train, validation]), np.concatenate(parts[:2]), limit)
    return tuple(sorted((row, other) for row, other in found if (images[row] != images[other]).any()))


def _pairs(
    found: npt.NDArray[np.float64], rows: _Rows, others: npt.NDArray[np.float64], other_rows: _Rows, limit: float
) -> list[tuple[int, int]]:
    """Find the rows whose thumbnail is nearer than a limit to one of the others; return each with its nearest one."""
    lengths, near = (others**2).sum(axis=1), []
    for start in range(0, len(found), _BLOCK):
        block = found[start : start + _BLOCK]
        distances = (block**2).sum(axis=1)[:, None] + lengths - 2 * block @ others.T
        nearest = distances.argmin(axis=1)
        for place in np.flatnonzero(distances.min(axis=1) < limit):
            near.append((int(rows[start + place]), int(other_rows[nearest[place]])))
    return near


def _thumbnails(images: npt.NDArray[np.uint8], rows: _Rows) -> npt.NDArray[np.float64]:
    """Average images to grey thumbnails, shape (len(rows), SIDE * SIDE), in units of the pixel values 0 to 255."""
    edges = np.linspace(0, images.shape[-1], SIDE + 1).astype(np.int64)
    areas = np.outer(np.diff(edges), np.diff(edges)) * images.shape[1]
    found = np.empty((len(rows), SIDE * SIDE))
    for place, row in enumerate(rows):
        grey = images[row].sum(axis=0, dtype=np.int64)
        sums = np.add.reduceat(np.add.reduceat(grey, edges[:-1], axis=0), edges[:-1], axis=1)
        found[place] = (sums / areas).ravel()
    return found
