"""What the test images say of a study's networks: ensembles of the seeds, every pair image by image, calibration.

The verdicts of `analysis.studies.comparison` resample seeds only: they hold for these test images. Here images are
resampled with the seeds, and the ensembles of the seeds, which are the networks as one would use them, are compared on
the same images.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.statistics.calibration import Calibration, calibration, predicted, probabilities
from analysis.statistics.effects import Interval
from analysis.statistics.images import (
    Floats,
    Paired,
    average,
    image_weights,
    mcnemar,
    mean_difference,
    resampled_means,
    signed_rank,
    squared_errors,
)
from analysis.statistics.tests import holm
from analysis.studies.comparison import Verdict
from analysis.studies.predictions import Predictions
from analysis.studies.scores import Study
from tacevo.randomness import stream
from tacevo.records import Kind
from tacevo.rounding import rounded


@dataclass(frozen=True, slots=True, kw_only=True)
class Ensemble:
    """A network as the mean of its seeds' predictions: of outputs, or of the classes' probabilities."""

    network: str
    #: Of the primary metric.
    score: float
    #: Mean primary metric of the seeds less the baseline's, over seeds and images; None of the baseline.
    difference: Interval | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """The ensembles of two networks on the same images."""

    first: str
    second: str
    #: By McNemar's test of right answers, or Wilcoxon's of squared errors.
    test: Paired
    #: After Holm's correction over the family of the pair.
    p_holm: float
    #: Of the first against the second; never `equivalent`, for which there is no test here.
    verdict: Verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputPair:
    """A variant against the baseline on one output of a regression."""

    output: str
    pair: Pair
    #: Mean squared error of the variant's seeds less the baseline's on that output, over seeds and images.
    difference: Interval


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibrated:
    """How well a classifier knows how sure it may be."""

    network: str
    #: One of each seed, in their order.
    seeds: tuple[Calibration, ...]
    ensemble: Calibration


@dataclass(frozen=True, slots=True, kw_only=True)
class Residuals:
    """What a network's predictions of one output are off by, in the scaled units of training."""

    output: str
    network: str
    #: Mean of prediction less label over the images, one of each seed.
    biases: tuple[float, ...]
    #: Population standard deviation of the same.
    spreads: tuple[float, ...]
    #: Both of the ensemble.
    bias: float
    spread: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageFindings:
    """All that the test images say of a study."""

    #: In the order of the study, the baseline first.
    ensembles: tuple[Ensemble, ...]
    #: Every two networks; one family.
    pairs: tuple[Pair, ...]
    #: Every network against the trivial predictor, which knows the test images' mean or majority; one more family.
    against_trivial: tuple[Pair, ...]
    #: Every variant on each output of a regression of several; one more family.
    outputs: tuple[OutputPair, ...]
    #: Of a classification.
    calibrations: tuple[Calibrated, ...]
    #: Of a regression; by output, then network.
    residuals: tuple[Residuals, ...]
    #: The predictor that looks at no image: always the class frequencies of the test images; None of a regression.
    trivial: Calibration | None
    #: Standard deviation of each output's test labels, which is the trivial predictor's spread; empty of classes.
    spreads: Mapping[str, float]


def image_findings(study: Study, predictions: Predictions, *, seed: int = 0) -> ImageFindings:
    """Compare the networks of a study on its test images.

    The seed is that of the bootstrap. All networks share the draws of the images, and each has draws of its seeds from
    a stream of its own, so another variant changes no interval.
    """
    if study.kind is Kind.classification:
        return _of_classes(study, predictions, seed)
    return _of_values(study, predictions, seed)


def _of_classes(study: Study, predictions: Predictions, seed: int) -> ImageFindings:
    labels = predictions.labels
    right = {name: (each.argmax(axis=2) == labels).astype(np.float64) for name, each in predictions.of.items()}
    chances = {name: [probabilities(one) for one in each] for name, each in predictions.of.items()}
    ensembles = {name: average(each) for name, each in chances.items()}
    hits = {name: predicted(mean) == labels for name, mean in ensembles.items()}
    differences = _differences(study, right, seed, "accuracy")
    frequencies = np.bincount(labels, minlength=len(study.names)) / len(labels)
    majority = labels == frequencies.argmax()
    return ImageFindings(
        ensembles=_ensembles({name: int(each.sum()) / len(each) for name, each in hits.items()}, differences),
        pairs=_pairs(study, [(one, other, mcnemar(hits[one], hits[other])) for one, other in _of_two(study)]),
        against_trivial=_pairs(study, [(name, "trivial", mcnemar(hits[name], majority)) for name in hits]),
        outputs=(),
        calibrations=tuple(
            Calibrated(
                network=name,
                seeds=tuple(calibration(one, labels) for one in chances[name]),
                ensemble=calibration(mean, labels),
            )
            for name, mean in ensembles.items()
        ),
        residuals=(),
        trivial=calibration(np.tile(frequencies, (len(labels), 1)), labels),
        spreads={},
    )


def _of_values(study: Study, predictions: Predictions, seed: int) -> ImageFindings:
    labels: Floats = predictions.labels.astype(np.float64)
    errors = {name: np.stack([squared_errors(one, labels) for one in each]) for name, each in predictions.of.items()}
    ensembles = {name: average(list(each)) for name, each in predictions.of.items()}
    means = {name: squared_errors(mean, labels) for name, mean in ensembles.items()}
    differences = _differences(study, errors, seed, "mse")
    mean = squared_errors(np.tile([_mean(column) for column in labels.T], (len(labels), 1)), labels)
    residuals = [
        _residuals(output, name, predictions.of[name][:, :, at], ensembles[name][:, at], labels[:, at])
        for at, output in enumerate(study.names)
        for name in predictions.of
    ]
    return ImageFindings(
        ensembles=_ensembles({name: _mean(each) for name, each in means.items()}, differences),
        pairs=_pairs(study, [(one, other, signed_rank(means[one], means[other])) for one, other in _of_two(study)]),
        against_trivial=_pairs(study, [(name, "trivial", signed_rank(means[name], mean)) for name in means]),
        outputs=_outputs(study, predictions, ensembles, seed) if len(study.names) > 1 else (),
        calibrations=(),
        residuals=tuple(residuals),
        trivial=None,
        spreads={output: _moments(labels[:, at])[1] for at, output in enumerate(study.names)},
    )


def _outputs(
    study: Study, predictions: Predictions, ensembles: Mapping[str, Floats], seed: int
) -> tuple[OutputPair, ...]:
    """Compare every variant with the baseline on each output; all of these are one family."""
    baseline, *variants = (network.name for network in study.networks)
    differences: list[Interval] = []
    tests = []
    for at, output in enumerate(study.names):
        labels = predictions.labels[:, at : at + 1]
        errors = {
            name: np.stack([squared_errors(one[:, at : at + 1], labels) for one in each])
            for name, each in predictions.of.items()
        }
        found = _differences(study, errors, seed, f"mse_{output}")
        means = {name: squared_errors(mean[:, at : at + 1], labels) for name, mean in ensembles.items()}
        differences += [found[name] for name in variants]
        tests += [(name, baseline, signed_rank(means[name], means[baseline])) for name in variants]
    names = [output for output in study.names for _ in variants]
    judged = zip(names, _pairs(study, tests), differences, strict=True)
    return tuple(OutputPair(output=output, pair=pair, difference=difference) for output, pair, difference in judged)


def _differences(study: Study, scores: Mapping[str, Floats], seed: int, metric: str) -> dict[str, Interval]:
    """Return each variant's mean score less the baseline's, with its interval over seeds and images."""
    baseline = study.networks[0].name
    weights = image_weights(scores[baseline].shape[1], rng=stream(seed, "images"))
    drawn = {
        name: resampled_means(each, weights, rng=stream(seed, "seeds", name, metric)) for name, each in scores.items()
    }
    return {
        name: mean_difference(each, scores[baseline], drawn[name], drawn[baseline])
        for name, each in scores.items()
        if name != baseline
    }


def _ensembles(scores: Mapping[str, float], differences: Mapping[str, Interval]) -> tuple[Ensemble, ...]:
    return tuple(
        Ensemble(network=name, score=rounded(score), difference=differences.get(name)) for name, score in scores.items()
    )


def _of_two(study: Study) -> list[tuple[str, str]]:
    """List every two networks, the later one first: a variant is compared with the baseline."""
    names = [network.name for network in study.networks]
    return [(later, earlier) for earlier, later in itertools.combinations(names, 2)]


def _pairs(study: Study, tests: Sequence[tuple[str, str, Paired]]) -> tuple[Pair, ...]:
    """Correct the tests of one family, and judge the first of each pair."""
    if not tests:
        return ()
    corrected = holm([test.p for _, _, test in tests])
    return tuple(
        Pair(first=first, second=second, test=test, p_holm=p, verdict=_verdict(test, p <= study.terms.alpha))
        for (first, second, test), p in zip(tests, corrected, strict=True)
    )


def _verdict(test: Paired, differs: bool) -> Verdict:
    if not differs:
        return Verdict.undecided
    return Verdict.better if test.lead > 0 else Verdict.worse


def _residuals(output: str, network: str, each: NDArray[Any], mean: Floats, labels: Floats) -> Residuals:
    moments = [_moments(one - labels) for one in each.astype(np.float64)]
    bias, spread = _moments(mean - labels)
    biases, spreads = zip(*moments, strict=True)
    return Residuals(output=output, network=network, biases=biases, spreads=spreads, bias=bias, spread=spread)


def _moments(values: Floats) -> tuple[float, float]:
    """Return mean and population deviation, from exact sums."""
    centre = _mean(values)
    return rounded(centre), rounded(float(np.sqrt(_mean((values - centre) ** 2))))


def _mean(values: Floats) -> float:
    return math.fsum(values.tolist()) / len(values)
