"""The numbers that inputs and targets are scaled with: exact, and of the training split only."""

import math

import numpy as np
import numpy.typing as npt

from tacevo.choices import Normalisation, TargetScaling
from tacevo.errors import DataError

#: Images whose pixels are counted at once; bounds the memory used at about 35 MB for 256 pixel images.
BLOCK = 64

#: Size of a label up to which sums of squares stay within floating-point numbers, and a label within 32 bits.
LARGEST_LABEL = 1e30


def input_statistics(
    images: npt.NDArray[np.uint8], train: npt.NDArray[np.int64], normalisation: Normalisation
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Find the mean and deviation that inputs are normalised with; `unit` looks at no pixel and gives 0 and 255.

    Both come from whole-number sums and correctly rounded operations, so their bits are equal on every machine. Images
    are of shape (N, C, S, S), and may be memory-mapped; only the rows `train` are looked at.

    Returns:
        Mean and population deviation per channel, in units of the pixel values 0 to 255. A channel that never
        changes has deviation 1, so that it becomes 0 everywhere.
    """
    channels = images.shape[1]
    if normalisation is Normalisation.unit:
        return (0.0,) * channels, (255.0,) * channels
    histograms = _histograms(images, train)
    moments = [_moments(histogram) for histogram in histograms]
    return tuple(mean for mean, _ in moments), tuple(deviation or 1.0 for _, deviation in moments)


def _histograms(images: npt.NDArray[np.uint8], rows: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Count how often each channel takes each of the 256 values; shape (C, 256)."""
    counts = np.zeros((images.shape[1], 256), dtype=np.int64)
    for start in range(0, len(rows), BLOCK):
        block = images[rows[start : start + BLOCK]]
        for channel in range(images.shape[1]):
            counts[channel] += np.bincount(block[:, channel].ravel(), minlength=256)
    return counts


def _moments(histogram: npt.NDArray[np.int64]) -> tuple[float, float]:
    """Mean and population deviation of the values 0 to 255 counted in a histogram."""
    counts = [int(count) for count in histogram]  # Python's integers: the squares below exceed 64 bits
    total = sum(counts)
    first = sum(value * count for value, count in enumerate(counts))
    second = sum(value * value * count for value, count in enumerate(counts))
    return first / total, math.sqrt(total * second - first * first) / total


def target_scale(
    labels: npt.NDArray[np.float64],
    train: npt.NDArray[np.int64],
    scaling: TargetScaling,
    names: tuple[str, ...],
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Find offset and scale per output, K each, where target = (label - offset) / scale; only rows `train` count.

    Labels are of shape (N, K), in the units of the recording, and no training label is beyond `LARGEST_LABEL` in size.

    Raises:
        DataError: an output has one value in the whole training split, so it can be neither scaled nor learnt.
    """
    columns = [[float(value) for value in column] for column in labels[train].T]
    constant = [name for name, column in zip(names, columns, strict=True) if min(column) == max(column)]
    if constant:
        raise DataError(
            "one value in the whole training split",
            place=f"label {', '.join(constant)}",
            remedy="add images in which it varies, or regress other outputs",
        )
    pairs = [_offset_and_scale(column, scaling) for column in columns]
    return tuple(offset for offset, _ in pairs), tuple(scale for _, scale in pairs)


def _offset_and_scale(column: list[float], scaling: TargetScaling) -> tuple[float, float]:
    """Offset and scale of one output; sums are exact (`fsum`), so the bits are equal on every machine."""
    match scaling:
        case TargetScaling.minmax:
            return min(column), max(column) - min(column)
        case TargetScaling.zscore:
            mean = math.fsum(column) / len(column)
            distances = [value - mean for value in column]
            # A product, which every machine rounds correctly; a power is the mathematics library's, which need not.
            return mean, math.sqrt(math.fsum(distance * distance for distance in distances) / len(column))
        case TargetScaling.none:
            return 0.0, 1.0
