"""What the test images say of a study's networks: ensembles of the seeds, and the variants on each output.

The verdicts of `analysis.studies.comparison` resample seeds only: they hold for these test images. Here images are
resampled with the seeds, and the ensembles of the seeds, which are the networks as one would use them, are compared on
the same images.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from analysis.statistics.effects import Interval
from analysis.statistics.images import (
    Floats,
    Paired,
    average,
    image_weights,
    mean_difference,
    predicted,
    probabilities,
    resampled_means,
    signed_rank,
    squared_errors,
)
from analysis.statistics.tests import holm
from analysis.studies.comparison import Verdict
from analysis.studies.predictions import Predictions
from tacevo.randomness import stream
from tacevo.records import Kind
from tacevo.results.study import RecordedStudy
from tacevo.results.study_lines import fewest_seeds
from tacevo.rounding import rounded

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
class OnOutput:
    """A variant against the baseline on one output, image by image."""

    output: str
    network: str
    #: Of the ensembles' squared errors, by Wilcoxon's test.
    test: Paired
    #: After Holm's correction over all variants and outputs.
    p_holm: float
    #: Mean squared error of its seeds less the baseline's, over seeds and images.
    difference: Interval
    #: Never `equivalent`, for which there is no test here. `better` and `worse` take the test and the interval, so that
    #: neither stands beside an interval that holds 0. None of fewer seeds than a comparison takes.
    verdict: Verdict | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageFindings:
    """All that the test images say of a study."""

    #: In the order of the study, the baseline first.
    ensembles: tuple[Ensemble, ...]
    #: Of a regression of several outputs; by output, then variant.
    outputs: tuple[OnOutput, ...]


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
    ensembles = {name: average([probabilities(one) for one in each]) for name, each in predictions.of.items()}
    scores = {name: int((predicted(mean) == labels).sum()) / len(labels) for name, mean in ensembles.items()}
    return ImageFindings(ensembles=_ensembles(study, scores, _differences(right, seed, "accuracy")), outputs=())


def _of_values(study: RecordedStudy, predictions: Predictions, seed: int) -> ImageFindings:
    labels: Floats = predictions.labels.astype(np.float64)
    errors = {name: np.stack([squared_errors(one, labels) for one in each]) for name, each in predictions.of.items()}
    ensembles = {name: average(list(each)) for name, each in predictions.of.items()}
    scores = {name: _mean(squared_errors(mean, labels)) for name, mean in ensembles.items()}
    return ImageFindings(
        ensembles=_ensembles(study, scores, _differences(errors, seed, "mse")),
        outputs=_outputs(study, predictions, ensembles, seed) if len(study.names) > 1 else (),
    )


def _outputs(
    study: RecordedStudy, predictions: Predictions, ensembles: Mapping[str, Floats], seed: int
) -> tuple[OnOutput, ...]:
    """Compare every variant with the baseline on each output; all of these are one family."""
    baseline, *variants = (network.name for network in study.networks)
    family: list[tuple[str, str, Paired, Interval]] = []
    for at, output in enumerate(study.names):
        labels = predictions.labels[:, at : at + 1]
        errors = {
            name: np.stack([squared_errors(one[:, at : at + 1], labels) for one in each])
            for name, each in predictions.of.items()
        }
        means = {name: squared_errors(mean[:, at : at + 1], labels) for name, mean in ensembles.items()}
        differ = _differences(errors, seed, f"mse_{output}")
        family += [
            (output, name, signed_rank(means[name], means[baseline]), differ(name, baseline)) for name in variants
        ]
    if not family:
        return ()
    return tuple(
        OnOutput(
            output=output,
            network=name,
            test=test,
            p_holm=p,
            difference=difference,
            verdict=_verdict(study, test, difference, is_shown=p <= study.terms.alpha),
        )
        for (output, name, test, difference), p in zip(family, holm([one[2].p for one in family]), strict=True)
    )


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


def _verdict(study: RecordedStudy, test: Paired, difference: Interval, *, is_shown: bool) -> Verdict | None:
    """Return the word for a variant whose errors were compared; `is_shown`: its test is significant after Holm."""
    if study.seeds < fewest_seeds(study.terms.alpha):
        return None
    if is_shown and test.lead > 0 and difference.high < 0:
        return Verdict.better
    if is_shown and test.lead <= 0 and difference.low > 0:
        return Verdict.worse
    return Verdict.undecided


def _mean(values: Floats) -> float:
    return math.fsum(values.tolist()) / len(values)
