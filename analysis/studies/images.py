"""What the test images say of a study's networks: ensembles of the seeds, every pair image by image, calibration.

The verdicts of `analysis.studies.comparison` resample seeds only: they hold for these test images. Here images are
resampled with the seeds, and the ensembles of the seeds, which are the networks as one would use them, are compared on
the same images.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
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
from tacevo.randomness import stream
from tacevo.records import Kind
from tacevo.results.study import LOWER_IS_BETTER, RecordedStudy
from tacevo.results.study_terms import fewest_seeds
from tacevo.rounding import rounded

#: The trivial predictor, among the names of networks, of which none is empty.
_TRIVIAL = ""

#: Tests two networks on the same images.
Test = Callable[[str, str], Paired]

#: Returns the difference of two networks, with its interval over seeds and images.
Differ = Callable[[str, str], Interval]


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
    #: Mean metric of the first's seeds less the second's, over seeds and images.
    difference: Interval
    #: Of the first against the second; never `equivalent`, for which there is no test here. `better` and `worse` take
    #: the test and the interval, so that neither stands beside an interval that holds 0. None of fewer seeds than a
    #: comparison takes.
    verdict: Verdict | None


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
    #: Every variant against the baseline on each output, by the output's name, of a regression of several; one more
    #: family. The difference is that of the mean squared errors on the output.
    outputs: tuple[tuple[str, Pair], ...]
    #: Of a classification.
    calibrations: tuple[Calibrated, ...]
    #: Of a regression; by output, then network.
    residuals: tuple[Residuals, ...]
    #: The predictor that looks at no image: always the class frequencies of the test images; None of a regression.
    trivial: Calibration | None
    #: Standard deviation of each output's test labels, which is the trivial predictor's spread; empty of classes.
    spreads: Mapping[str, float]


def image_findings(study: RecordedStudy, predictions: Predictions, *, seed: int = 0) -> ImageFindings:
    """Compare the networks of a study on its test images.

    The seed is that of the bootstrap. All networks share the draws of the images, and each has draws of its seeds from
    a stream of its own, so another variant changes no interval.
    """
    if study.kind is Kind.classification:
        return _of_classes(study, predictions, seed)
    return _of_values(study, predictions, seed)


def _of_classes(study: RecordedStudy, predictions: Predictions, seed: int) -> ImageFindings:
    labels = predictions.labels
    right = {name: (each.argmax(axis=2) == labels).astype(np.float64) for name, each in predictions.of.items()}
    chances = {name: [probabilities(one) for one in each] for name, each in predictions.of.items()}
    ensembles = {name: average(each) for name, each in chances.items()}
    hits = {name: predicted(mean) == labels for name, mean in ensembles.items()}
    frequencies = np.bincount(labels, minlength=len(study.names)) / len(labels)
    hits[_TRIVIAL] = labels == frequencies.argmax()
    right[_TRIVIAL] = hits[_TRIVIAL][None].astype(np.float64)
    differ = _differences(right, seed, "accuracy")

    def test(one: str, other: str) -> Paired:
        return mcnemar(hits[one], hits[other])

    return ImageFindings(
        ensembles=_ensembles(study, {name: int(hits[name].sum()) / len(labels) for name in ensembles}, differ),
        pairs=_pairs(study, [(*pair, test, differ) for pair in _of_two(study)]),
        against_trivial=_pairs(study, [(*pair, test, differ) for pair in _with_trivial(study)]),
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


def _of_values(study: RecordedStudy, predictions: Predictions, seed: int) -> ImageFindings:
    labels: Floats = predictions.labels.astype(np.float64)
    errors = {name: np.stack([squared_errors(one, labels) for one in each]) for name, each in predictions.of.items()}
    ensembles = {name: average(list(each)) for name, each in predictions.of.items()}
    means = {name: squared_errors(mean, labels) for name, mean in ensembles.items()}
    means[_TRIVIAL] = squared_errors(np.tile([_mean(column) for column in labels.T], (len(labels), 1)), labels)
    errors[_TRIVIAL] = means[_TRIVIAL][None]
    test, differ = partial(_by_errors, means), _differences(errors, seed, "mse")
    residuals = [
        _residuals(output, name, predictions.of[name][:, :, at], ensembles[name][:, at], labels[:, at])
        for at, output in enumerate(study.names)
        for name in predictions.of
    ]
    return ImageFindings(
        ensembles=_ensembles(study, {name: _mean(means[name]) for name in ensembles}, differ),
        pairs=_pairs(study, [(*pair, test, differ) for pair in _of_two(study)]),
        against_trivial=_pairs(study, [(*pair, test, differ) for pair in _with_trivial(study)]),
        outputs=_outputs(study, predictions, ensembles, seed) if len(study.names) > 1 else (),
        calibrations=(),
        residuals=tuple(residuals),
        trivial=None,
        spreads={output: _moments(labels[:, at])[1] for at, output in enumerate(study.names)},
    )


def _outputs(
    study: RecordedStudy, predictions: Predictions, ensembles: Mapping[str, Floats], seed: int
) -> tuple[tuple[str, Pair], ...]:
    """Compare every variant with the baseline on each output; all of these are one family."""
    baseline, *variants = (network.name for network in study.networks)
    family: list[tuple[str, str, Test, Differ]] = []
    for at, output in enumerate(study.names):
        labels = predictions.labels[:, at : at + 1]
        errors = {
            name: np.stack([squared_errors(one[:, at : at + 1], labels) for one in each])
            for name, each in predictions.of.items()
        }
        means = {name: squared_errors(mean[:, at : at + 1], labels) for name, mean in ensembles.items()}
        test, differ = partial(_by_errors, means), _differences(errors, seed, f"mse_{output}")
        family += [(name, baseline, test, differ) for name in variants]
    outputs = [output for output in study.names for _ in variants]
    return tuple(zip(outputs, _pairs(study, family), strict=True))


def _by_errors(means: Mapping[str, Floats], one: str, other: str) -> Paired:
    """Test two ensembles by their squared errors on the images."""
    return signed_rank(means[one], means[other])


def _differences(scores: Mapping[str, Floats], seed: int, metric: str) -> Differ:
    """Return what gives the mean score of a network less another's, with its interval over seeds and images."""
    weights = image_weights(next(iter(scores.values())).shape[1], rng=stream(seed, "images"))
    drawn = {
        name: resampled_means(each, weights, rng=stream(seed, "seeds", name, metric)) for name, each in scores.items()
    }
    return lambda one, other: mean_difference(scores[one], scores[other], drawn[one], drawn[other])


def _ensembles(study: RecordedStudy, scores: Mapping[str, float], differ: Differ) -> tuple[Ensemble, ...]:
    baseline = study.networks[0].name
    return tuple(
        Ensemble(network=name, score=rounded(score), difference=None if name == baseline else differ(name, baseline))
        for name, score in scores.items()
    )


def _of_two(study: RecordedStudy) -> list[tuple[str, str]]:
    """List every two networks, the later one first: a variant is compared with the baseline."""
    names = [network.name for network in study.networks]
    return [(later, earlier) for earlier, later in itertools.combinations(names, 2)]


def _with_trivial(study: RecordedStudy) -> list[tuple[str, str]]:
    return [(network.name, _TRIVIAL) for network in study.networks]


def _pairs(study: RecordedStudy, family: Sequence[tuple[str, str, Test, Differ]]) -> tuple[Pair, ...]:
    """Test the pairs of one family, correct, and judge the first of each."""
    if not family:
        return ()
    tests = [test(one, other) for one, other, test, _ in family]
    return tuple(
        Pair(
            first=one,
            second=other or "trivial",
            test=tested,
            p_holm=p,
            difference=(difference := differ(one, other)),
            verdict=_verdict(study, tested, difference, is_shown=p <= study.terms.alpha),
        )
        for (one, other, _, differ), tested, p in zip(family, tests, holm([one.p for one in tests]), strict=True)
    )


def _verdict(study: RecordedStudy, test: Paired, difference: Interval, *, is_shown: bool) -> Verdict | None:
    """Return the word for the first of a pair; `is_shown` says whether its test is significant after Holm."""
    if study.seeds < fewest_seeds(study.terms.alpha):
        return None
    leads = test.lead > 0
    is_below = leads == LOWER_IS_BETTER[study.primary]
    if not is_shown or not (difference.high < 0 if is_below else difference.low > 0):
        return Verdict.undecided
    return Verdict.better if leads else Verdict.worse


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
