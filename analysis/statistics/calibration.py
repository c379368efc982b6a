"""Does a classifier know how sure it may be: reliability, expected calibration error, Brier score. Pure."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis.statistics.images import Floats
from tacevo.rounding import rounded

#: Equal parts of the confidences from 0 to 1.
BINS = 10

#: Decimals that probabilities keep, so that those which should tie do, on every CPU.
_DECIMALS = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Bin:
    """The images on which a classifier is about equally sure."""

    #: Of them, at least 1.
    images: int
    #: Mean probability of the predicted class, in [0, 1].
    confidence: float
    #: Part that is right, in [0, 1].
    accuracy: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """How probabilities and truth agree; of every figure but the accuracy, less is better."""

    #: In [0, 1].
    accuracy: float
    #: Expected calibration error, in [0, 1]: the mean distance of accuracy and confidence over the bins, weighted by
    #: their images (Naeini et al. 2015; Guo et al. 2017). With few images it is above 0 for a perfect classifier, too.
    ece: float
    #: Brier's (1950) score over all classes, in [0, 2].
    brier: float
    #: Mean of minus the logarithm of the true class's probability, in nats; infinite never, see `calibration`.
    cross_entropy: float
    #: Those that hold an image, in the order of confidence.
    bins: tuple[Bin, ...]


def probabilities(logits: ArrayLike) -> Floats:
    """Return the softmax of finite logits, shape (t, K), to 12 decimals."""
    values = np.asarray(logits, dtype=np.float64)
    powers = np.exp(values - values.max(axis=1, keepdims=True))
    chances: Floats = np.round(powers / sum(powers.T)[:, None], _DECIMALS)
    return chances


def predicted(chances: Floats) -> NDArray[np.int64]:
    """Return the most probable class of each image, shape (t,); the first of equally probable ones."""
    classes: NDArray[np.int64] = chances.round(_DECIMALS).argmax(axis=1)
    return classes


def calibration(chances: Floats, classes: NDArray[np.int64]) -> Calibration:
    """Compare probabilities with the truth.

    Args:
        chances: shape (t, K), t >= 1, each in [0, 1]; a true class of less than 1e-12 counts as that.
        classes: shape (t,), each in [0, K).

    Raises:
        ValueError: the shapes do not suit each other.
    """
    if chances.ndim != 2 or not chances.size or classes.shape != chances.shape[:1]:
        raise ValueError(f"expected t x K probabilities and t classes; got shapes {chances.shape} and {classes.shape}")
    rows = np.arange(len(classes))
    right, sure = predicted(chances) == classes, chances.max(axis=1)
    truth = np.zeros(chances.shape)
    truth[rows, classes] = 1
    likely = np.maximum(chances[rows, classes], 10.0**-_DECIMALS)
    bins = tuple(_bins(sure, right))
    gaps = [one.images * abs(one.accuracy - one.confidence) for one in bins]
    return Calibration(
        accuracy=rounded(int(right.sum()) / len(right)),
        ece=rounded(math.fsum(gaps) / len(right)),
        brier=rounded(math.fsum(((chances - truth) ** 2).ravel().tolist()) / len(right)),
        cross_entropy=rounded(-math.fsum(map(math.log, likely.tolist())) / len(right)),
        bins=bins,
    )


def _bins(sure: Floats, right: NDArray[np.bool_]) -> list[Bin]:
    """Divide images by how sure the classifier is; a confidence on a border belongs to the bin below."""
    places = np.clip(np.ceil(np.round(sure * BINS, _DECIMALS)).astype(np.int64) - 1, 0, BINS - 1)
    found = []
    for place in np.unique(places):
        chosen = places == place
        count = int(chosen.sum())
        confidence = rounded(math.fsum(sure[chosen].tolist()) / count)
        found.append(Bin(images=count, confidence=confidence, accuracy=rounded(int(right[chosen].sum()) / count)))
    return found
