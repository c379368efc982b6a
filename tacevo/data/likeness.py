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

#: Most images that are compared of a part, at even steps.
_MOST = 10_000


def nearly_equal(dataset: Dataset) -> tuple[tuple[int, int], ...]:
    """Find the validation and test images that are nearly equal, but not equal, to an image of an earlier part.

    The parts are in the order training, validation, test.

    Returns:
        Each such row, ascending, with the row that it is nearest to.
    """
    from sklearn.metrics import pairwise_distances_argmin_min  # a second to import, for recordings only

    images: npt.NDArray[np.uint8] = np.load(dataset.images, mmap_mode="r")
    parts = [rows[:: -(-len(rows) // _MOST)] for rows in (dataset.train, dataset.validation, dataset.test)]
    rows, held_out = np.concatenate(parts), len(parts[0])
    thumbnails = np.array([_thumbnail(images[row]) for row in rows])
    thumbnails -= thumbnails[:held_out].mean(axis=0)
    limit = 2 * float((thumbnails[:held_out] ** 2).sum(axis=1).mean()) / ALIKE
    pairs: list[tuple[int, int]] = []
    for start, end in ((held_out, held_out + len(parts[1])), (held_out + len(parts[1]), len(rows))):
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
