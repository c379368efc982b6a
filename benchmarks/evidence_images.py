"""Tests and intervals over test images, simulated where the truth is known: networks that do not differ.

An image is as hard for one network as for the other, each seed is better or worse on all images, and the rest is noise.
`benchmarks.evidence` runs these with all others.
"""

from collections.abc import Callable

import numpy as np
from scipy.special import expit

from analysis.statistics.images import (
    Floats,
    Paired,
    image_weights,
    mean_difference,
    resampled_means,
    signed_rank,
)
from analysis.statistics.tests import holm

#: Of a bootstrap here; see `benchmarks.evidence`.
_RESAMPLES = 399

_ALPHA = 0.05

Trial = Callable[[np.random.Generator], bool]


def _errors(rng: np.random.Generator, networks: int, images: int) -> Floats:
    """Err on images of shared difficulty, skewed as squared errors are."""
    hard = rng.normal(size=images)
    return np.exp(hard + 0.5 * rng.normal(size=(networks, images))) * rng.chisquare(3, size=(networks, images))


def _any(tests: list[Paired]) -> bool:
    return min(holm([test.p for test in tests])) <= _ALPHA if len(tests) > 1 else tests[0].p <= _ALPHA


def _signed_rank(networks: int, images: int) -> Trial:
    """Call any two regressions different, after Holm."""

    def trial(rng: np.random.Generator) -> bool:
        errors = _errors(rng, networks, images)
        return _any([signed_rank(errors[i], errors[j]) for i in range(networks) for j in range(i)])

    return trial


def _difference_covered(seeds: int, images: int, *, classes: bool) -> Trial:
    """Cover the difference of two networks that do not differ, over seeds and images."""

    def trial(rng: np.random.Generator) -> bool:
        hard, able = rng.normal(1.0, 1.0, size=images), 0.3 * rng.normal(size=(2, seeds, 1))
        if classes:
            scores = np.asarray(rng.random((2, seeds, images)) < expit(hard + able), dtype=np.float64)
        else:
            scores = np.exp(hard + able + 0.5 * rng.normal(size=(2, seeds, images)))
        weights = image_weights(images, rng=rng, resamples=_RESAMPLES)
        drawn = [resampled_means(each, weights, rng=rng) for each in scores]
        found = mean_difference(scores[0], scores[1], drawn[0], drawn[1])
        return found.low <= 0 <= found.high

    return trial


FALSE: dict[str, Trial] = {
    "signed ranks, 30 images (exact)": _signed_rank(2, 30),
    "signed ranks, 300 images (normal)": _signed_rank(2, 300),
    "signed ranks, Holm, 10 pairs, 56 images": _signed_rank(5, 56),
}

COVERED: dict[str, Trial] = {
    "difference of MSE, 20 seeds, 56 images": _difference_covered(20, 56, classes=False),
    "difference of MSE, 20 seeds, 300 images": _difference_covered(20, 300, classes=False),
    "difference of MSE, 5 seeds, 56 images": _difference_covered(5, 56, classes=False),
    "difference of accuracy, 20 seeds, 56 images": _difference_covered(20, 56, classes=True),
}
