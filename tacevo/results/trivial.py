"""The score of a predictor that looks at no image: it knows the mean of the test labels, or their most frequent class.

It follows from scores that every study has, so it needs neither labels nor a training. It knows the mean, or the
majority, of the test images themselves, and so is a little better than one that knows the training images only.
"""

import math
from collections.abc import Mapping, Sequence
from statistics import fmean

import numpy as np

from tacevo.evolution.chance import MARGIN, is_at_chance
from tacevo.results.study import LOWER_IS_BETTER, RecordedStudy
from tacevo.results.study_lines import ScoreLine
from tacevo.rounding import rounded
from tacevo.training.losses import entropy
from tacevo.training.metrics import Confusion, macro_f1


def trivial_score(study: RecordedStudy) -> float | None:
    """Return the trivial predictor's score in the study's primary metric; None where the scores do not tell."""
    return trivial_metrics(study).get(study.primary)


def trivial_metrics(study: RecordedStudy) -> dict[str, float]:
    """Return the trivial predictor's test metrics, by name; see `metrics_from`."""
    return metrics_from(study.scores, study.names)


def at_chance(study: RecordedStudy) -> tuple[str, ...]:
    """Say that no network's median score is better than chance (`tacevo.evolution.chance`); nothing where one is."""
    trivial, is_error = trivial_score(study), LOWER_IS_BETTER[study.primary]
    if trivial is None:
        return ()
    medians = [float(np.median(study.values(network.name, study.primary))) for network in study.networks]
    best, least = (min(medians), trivial) if is_error else (1 - max(medians), 1 - trivial)
    if not is_at_chance(best, least):
        return ()
    what = "error" if is_error else "share of wrong answers"
    return (f"At chance: no network's median {what} is more than {100 * MARGIN:g} % below the trivial predictor's.",)


def metrics_from(scores: Sequence[ScoreLine], names: Sequence[str]) -> dict[str, float]:
    """Return the trivial predictor's test metrics, by name; those that the scores do not tell are left out.

    Of a classification, what always predicting the most frequent class gives; its cross-entropy is that of the class
    frequencies, since that of a certainty is infinite. Of a regression, an output's MSE is its labels' variance:
    since R² = 1 - MSE / variance, it is MSE / (1 - R²). Absolute errors do not follow from scores.

    Args:
        scores: of one study, at least one.
        names: of the regressed values or classes.
    """
    confusion = scores[0].confusion
    metrics = _of_outputs(scores, names) if confusion is None else _of_classes(confusion)
    return {name: rounded(value) for name, value in metrics.items()}


def _of_classes(confusion: Confusion) -> dict[str, float]:
    classes = [sum(row) for row in confusion]
    majority, total = classes.index(max(classes)), sum(classes)
    always = tuple(tuple(count if column == majority else 0 for column in range(len(classes))) for count in classes)
    return {"accuracy": max(classes) / total, "macro_f1": macro_f1(always), "cross_entropy": entropy(classes)}


def _of_outputs(scores: Sequence[ScoreLine], names: Sequence[str]) -> dict[str, float]:
    worst = {name: _most_wrong(scores, name) for name in names}
    values: dict[str, float] = {}
    for name, metrics in worst.items():
        if metrics is not None:
            mse, r2 = metrics[f"mse_{name}"], metrics[f"r2_{name}"]
            variance = mse / (1 - r2)
            values |= {f"mse_{name}": variance, f"rmse_{name}": math.sqrt(variance), f"r2_{name}": 0.0}
            if recorded := metrics.get(f"recorded_rmse_{name}"):
                values[f"recorded_rmse_{name}"] = recorded * math.sqrt(variance / mse)
    if worst and None not in worst.values():
        mean = fmean(values[f"mse_{name}"] for name in names)
        values |= {"mse": mean, "rmse": math.sqrt(mean), "r2": 0.0}
    return values


def _most_wrong(scores: Sequence[ScoreLine], output: str) -> Mapping[str, float] | None:
    """Return the metrics that tell the variance of an output's test labels best: those of the largest error."""
    mse, r2 = f"mse_{output}", f"r2_{output}"
    told = [score.metrics for score in scores if mse in score.metrics and score.metrics.get(r2, 1) < 1]
    return max(told, key=lambda metrics: metrics[mse], default=None)
