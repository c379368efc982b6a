"""What a predictor scores that looks at no image: the mean of the test labels, or their most frequent class.

It follows from scores that every study has, so it needs neither labels nor a training. It knows the mean, or the
majority, of the test images themselves, and so is a little better than one that knows the training images only.
"""

from collections.abc import Mapping, Sequence
from statistics import fmean

from analysis.studies.scores import Study
from tacevo.rounding import rounded


def trivial_score(study: Study) -> float | None:
    """Return the trivial predictor's score in the study's primary metric; None where the scores do not tell.

    Of a classification, the share of the most frequent class. Of a regression, the mean over the outputs of their
    labels' variance: since R² = 1 - MSE / variance, it is MSE / (1 - R²).
    """
    first = study.scores[0]
    if first.confusion is not None:
        classes = [sum(row) for row in first.confusion]
        return rounded(max(classes) / sum(classes))
    variances = [_variance([score.metrics for score in study.scores], name) for name in study.names]
    known = [variance for variance in variances if variance is not None]
    return rounded(fmean(known)) if known and len(known) == len(variances) else None


def _variance(scores: Sequence[Mapping[str, float]], output: str) -> float | None:
    """Return the variance of an output's test labels, by the score that tells it best: that of the largest error."""
    mse, r2 = f"mse_{output}", f"r2_{output}"
    told = [metrics for metrics in scores if mse in metrics and metrics.get(r2, 1) < 1]
    if not told:
        return None
    worst = max(told, key=lambda metrics: metrics[mse])
    return worst[mse] / (1 - worst[r2])
