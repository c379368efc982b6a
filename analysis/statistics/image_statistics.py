"""Statistics over test images and seeds: a bootstrap over both, and a test of ensembles image by image. Pure.

A network has a prediction for each of t images under each of S seeds. Images that were recorded together, such as the
frames of a press, are not independent: where groups are known, each counts once. docs/statistics.md says what each of
these asks.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist, mean

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import rankdata, wilcoxon

from analysis.statistics.effects import interval
from analysis.statistics.tests import POWER
from analysis.table import Interval
from tacevo.rounding import rounded

Floats = NDArray[np.float64]

#: The bootstrap samples of images and seeds together: one less than 2,000, so that the ends of a 95 %
#: interval are the 50th from either side.
IMAGE_RESAMPLES = 1_999

#: Sums of whole numbers of at most this many bits are exact in floating point, in whatever order they are added.
_EXACT_BITS = 53

#: Decimals that probabilities keep, so that those which should tie do, on every CPU.
_DECIMALS = 12

#: Differences up to which every assignment of signs is counted, if no two of them tie.
_COUNTED = 50


def drawn_again(count: int, *, rng: np.random.Generator, resamples: int = IMAGE_RESAMPLES) -> NDArray[np.int64]:
    """Draw all images, groups of images, or seeds, but one with replacement, again and again.

    As many draws as images would make an interval too narrow, by the square root of (n - 1) / n (Rao & Wu 1988).

    Returns:
        How often each was drawn, shape (resamples, count).
    """
    chosen = rng.integers(count, size=(resamples, max(1, count - 1))) + count * np.arange(resamples)[:, None]
    return np.bincount(chosen.ravel(), minlength=resamples * count).reshape(resamples, count)


def resampled_means(scores: ArrayLike, weights: NDArray[np.int64], *, rng: np.random.Generator) -> Floats:
    """Average a network's scores over resampled seeds and images: the pigeonhole bootstrap (Owen 2007).

    Args:
        scores: shape (S, t), finite: of each seed on each image.
        weights: of the images, by `drawn_again`, those of a group alike; the same for all networks, since they are
            tested on the same images.
        rng: draws the seeds, S - 1 with replacement in each resample (one of one); equal states give equal bits, on
            every machine.

    Returns:
        Shape (resamples,).
    """
    values = np.asarray(scores, dtype=np.float64)
    # Where groups differ in size, a resample may have more images than there are.
    whole, factor = _whole(values, max(values.size, len(values) * int(weights.sum(axis=1).max())))
    drawn = drawn_again(len(whole), rng=rng, resamples=len(weights))
    sums = np.einsum("ri,ri->r", drawn.astype(np.float64) @ whole, weights.astype(np.float64))
    return np.asarray(sums / (factor * drawn.sum(axis=1) * weights.sum(axis=1)), dtype=np.float64)


def mean_difference(x: ArrayLike, y: ArrayLike, drawn_x: Floats, drawn_y: Floats) -> Interval:
    """Return the difference of two networks' mean scores, with its interval over seeds and images.

    Args:
        x: scores of the first, shape (S, t).
        y: of the second, shape (S', t).
        drawn_x: of `resampled_means` of the first.
        drawn_y: of the second, by the same weights of images.
    """
    difference = _mean(np.asarray(x, dtype=np.float64)) - _mean(np.asarray(y, dtype=np.float64))
    return interval(difference, drawn_x - drawn_y)


def signed_rank(first: ArrayLike, second: ArrayLike, groups: ArrayLike | None = None) -> dict[str, float]:
    """Test whether two regressions err equally much on the same images: Wilcoxon's (1945) signed-rank test.

    The difference of a group is the mean over its images. Groups on which both err equally are left out. Exact up to 50
    others whose differences do not tie in size, and otherwise the normal approximation, corrected for ties and
    continuity.

    Args:
        first: errors of the first, shape (t,), finite; less is better.
        second: of the second.
        groups: of the images, shape (t,), numbered from 0; None where each image is one.

    Returns:
        On how many groups the first is `better` and `worse`; its `lead`, how far it is ahead, in ranks (below 0 it is
        behind); `p`, two-sided, in (0, 1].
    """
    differences = np.subtract(first, second, dtype=np.float64)
    if groups is not None:
        differences = _means(differences, np.asarray(groups))
    differences = differences[differences != 0]
    if not differences.size:
        return {"better": 0, "worse": 0, "lead": 0.0, "p": 1.0}
    counted = len(differences) <= _COUNTED and len(np.unique(np.abs(differences))) == len(differences)
    test = wilcoxon(differences, method="exact" if counted else "approx", correction=not counted)
    ranks = rankdata(np.abs(differences))  # midranks are halves, so their sum is exact
    return {
        "better": int((differences < 0).sum()),
        "worse": int((differences > 0).sum()),
        "lead": -float((np.sign(differences) * ranks).sum()),
        "p": rounded(float(test.pvalue)),
    }


def detectable_lead(count: int, *, alpha: float) -> tuple[float, float] | None:
    """Return the smallest effect that `signed_rank` of so many groups finds with a power of 80 % (Noether 1987).

    Returns:
        The chance that two groups together favour the better network, in (0.5, 1); and the mean difference that makes
        it, in standard deviations of a normal distribution. None where the formula gives no effect for so few.
    """
    quantile = NormalDist().inv_cdf
    chance = 0.5 + (quantile(1 - alpha / 2) + quantile(POWER)) / math.sqrt(3 * count)
    return None if chance >= 1 else (rounded(chance), rounded(quantile(chance) / math.sqrt(2)))


def average(predictions: Sequence[NDArray[np.floating]]) -> Floats:
    """Return the mean of the seeds' predictions, each of shape (t, K); summed in their order, on every machine."""
    total = np.zeros(predictions[0].shape)
    for one in predictions:
        total += one
    return total / len(predictions)


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


def squared_errors(predictions: ArrayLike, labels: ArrayLike) -> Floats:
    """Return the squared error of each image, shape (t,), the mean over the K outputs; arguments have shape (t, K)."""
    errors = np.asarray(predictions, dtype=np.float64) - np.asarray(labels, dtype=np.float64)
    total = np.zeros(len(errors))
    for column in errors.T:
        total += column * column
    mean: Floats = total / errors.shape[1]
    return mean


def _means(values: Floats, groups: NDArray[np.int64]) -> Floats:
    """Return the mean of each group, rounded once: so an image that stands there several times changes no bit."""
    ends = np.bincount(groups).cumsum()[:-1]
    return np.array([mean(own.tolist()) for own in np.split(values[groups.argsort(kind="stable")], ends)])


def _whole(scores: Floats, terms: int) -> tuple[Floats, float]:
    """Turn scores into whole numbers, by a power of two as a factor, so that sums of so many are exact in any order."""
    largest = float(np.abs(scores).max())
    if largest == 0:
        return scores, 1.0
    bits = _EXACT_BITS - (terms - 1).bit_length()
    factor = math.ldexp(1.0, bits - math.frexp(largest)[1])
    return np.round(scores * factor), factor


def _mean(scores: Floats) -> float:
    whole, factor = _whole(scores, scores.size)
    return float(whole.sum() / (factor * whole.size))
