"""The test metrics of a network, from its predictions: pure, and equal on every machine.

Sums are exact (`math.fsum`) and results are rounded to 9 significant digits, as in `training.losses`. Definitions are
those of scikit-learn, where it has the metric.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacevo.records import Kind
from tacevo.rounding import rounded
from tacevo.training.losses import cross_entropy

#: Rows are true classes, columns are predicted ones; entries count images.
Confusion = tuple[tuple[int, ...], ...]


def metric_names(kind: Kind, names: Sequence[str]) -> set[str]:
    """Return the names of all metrics; `names` are those of the outputs of a regression."""
    if kind is Kind.classification:
        return {"accuracy", "macro_f1", "cross_entropy"}
    every, in_units = ("mse", "mae", "rmse", "r2"), ("recorded_mae", "recorded_rmse")
    return {*every, *(f"{metric}_{name}" for metric in (*every, *in_units) for name in names)}


def regression_metrics(
    predictions: NDArray[np.float32], targets: NDArray[np.float32], *, names: Sequence[str], scale: Sequence[float]
) -> dict[str, float]:
    """Compute the metrics of a regression.

    Args:
        predictions: shape (n, K), finite, in the scaled units of training.
        targets: shape (n, K), the same.
        names: of the K outputs.
        scale: shape (K,), positive; units of the recording for one unit of training.

    Returns:
        In the units of training: `mse`, `mae`, `rmse`, `r2` over all outputs, and of each output as `mse_<name>` and so
        on. In the units of the recording: `recorded_mae_<name>` and `recorded_rmse_<name>`. Over all outputs, `mse` and
        `mae` are means over all values, `rmse` is the root of `mse`, and `r2` the plain mean of the outputs' R².
    """
    errors = predictions.astype(np.float64) - targets.astype(np.float64)
    metrics = {"mse": _mean(errors * errors), "mae": _mean(np.abs(errors)), "rmse": math.sqrt(_mean(errors * errors))}
    apart = [r_squared(column, truth) for column, truth in zip(errors.T, targets.T.astype(np.float64), strict=True)]
    metrics["r2"] = math.fsum(apart) / len(apart)
    for name, column, r2, unit in zip(names, errors.T, apart, scale, strict=True):
        mse, mae = _mean(column * column), _mean(np.abs(column))
        metrics |= {f"mse_{name}": mse, f"mae_{name}": mae, f"rmse_{name}": math.sqrt(mse), f"r2_{name}": r2}
        metrics |= {f"recorded_mae_{name}": unit * mae, f"recorded_rmse_{name}": unit * math.sqrt(mse)}
    return _rounded(metrics)


def r_squared(errors: NDArray[np.float64], targets: NDArray[np.float64]) -> float:
    """Compute the coefficient of determination of one output.

    Targets without variance have none; as in scikit-learn, it is then 1 for perfect predictions and 0 for others.
    """
    values = targets.tolist()
    centre = math.fsum(values) / len(values)
    total = math.fsum((value - centre) ** 2 for value in values)
    left = math.fsum((errors * errors).tolist())
    if min(values) == max(values):
        return 1.0 if left == 0 else 0.0
    return 1 - left / total


def classification_metrics(logits: NDArray[np.float32], classes: NDArray[np.int64]) -> dict[str, float]:
    """Compute `accuracy`, `macro_f1` and `cross_entropy` (in nats); arguments are those of `confusion`."""
    counts = confusion(logits, classes)
    return counted_metrics(counts) | _rounded({"cross_entropy": cross_entropy(logits, classes)})


def counted_metrics(counts: Confusion) -> dict[str, float]:
    """Compute `accuracy` and `macro_f1`, which follow from the confusion of at least one image."""
    right = sum(row[number] for number, row in enumerate(counts))
    return _rounded({"accuracy": right / sum(map(sum, counts)), "macro_f1": macro_f1(counts)})


def contradiction(
    kind: Kind, names: Sequence[str], metrics: Mapping[str, float], counts: Confusion | None, *, images: int
) -> tuple[str, str, str] | None:
    """Find what the metrics of a network cannot be, as they follow from each other and from the confusion.

    Args:
        kind: of the task.
        names: of its K outputs.
        metrics: by name; those that are missing are not compared.
        counts: of a classification, shape (K, K), `images` in all; None of a regression.
        images: how many were predicted, at least 1.

    Returns:
        What it is, what stands there, and what was expected; None where nothing contradicts.
    """
    if kind is Kind.regression:
        if counts is not None:
            return "confusion", f"{counts}", "none of a regression"
        follows = _errors_by_others(names, metrics)
        basis, tolerance = "the other metrics", 1e-7  # what is compared was rounded to 9 significant digits
    else:
        rows, outputs = counts or (), len(names)
        every = [count for row in rows for count in row]
        if not ([len(row) for row in rows] == [outputs] * outputs and sum(every) == images and min(every) >= 0):
            return "confusion", f"{counts}", f"{outputs} rows of as many counts, {images} images in all"
        follows, basis, tolerance = counted_metrics(rows), "the confusion", 0.0
    for name, value in follows.items():
        if name in metrics and not math.isclose(metrics[name], value, rel_tol=tolerance, abs_tol=1e-12 * tolerance):
            return f"metrics.{name}", str(metrics[name]), f"{rounded(value)}, by {basis}"
    for name, value in metrics.items():
        if not name.startswith("r2") and not value >= 0:
            return f"metrics.{name}", str(value), "0 or more"
    return None if counts is None or "cross_entropy" not in metrics else _contradiction_of_loss(metrics, counts)


def _contradiction_of_loss(metrics: Mapping[str, float], counts: Confusion) -> tuple[str, str, str] | None:
    """Compare a cross-entropy with its bounds by the answers of the confusion."""
    loss, images = metrics["cross_entropy"], sum(map(sum, counts))
    right = sum(row[number] for number, row in enumerate(counts))
    # A wrong class is at least as probable as the true one, which has one half at most.
    least = (images - right) / images * math.log(2)
    if not loss >= least * (1 - 1e-7):
        return "metrics.cross_entropy", str(loss), f"{rounded(least)} or more, by the wrong answers of the confusion"
    # And a true class that is the most probable of K has 1 / K at least.
    if right == images and not loss <= math.log(len(counts)) * (1 + 1e-7):
        return "metrics.cross_entropy", str(loss), f"{rounded(math.log(len(counts)))} or less, as all answers are right"
    return None


def _errors_by_others(names: Sequence[str], metrics: Mapping[str, float]) -> dict[str, float]:
    """Compute the metrics of a regression that follow from others of them."""
    follows = {}
    for name in ("mse", "mae", "r2"):
        apart = [metrics[f"{name}_{each}"] for each in names if f"{name}_{each}" in metrics]
        if len(apart) == len(names):
            follows[name] = math.fsum(apart) / len(names)
    for end in ("", *(f"_{each}" for each in names)):
        if metrics.get(f"mse{end}", -1.0) >= 0:
            follows[f"rmse{end}"] = math.sqrt(metrics[f"mse{end}"])
    return follows


def confusion(logits: NDArray[np.float32], classes: NDArray[np.int64]) -> Confusion:
    """Count images by true and predicted class, shape (K, K).

    Args:
        logits: shape (n, K), finite; the first of equal ones wins.
        classes: shape (n,), each in [0, K).
    """
    counts = np.zeros((logits.shape[1],) * 2, np.int64)
    np.add.at(counts, (classes, logits.argmax(axis=1)), 1)
    return tuple(map(tuple, counts.tolist()))


def macro_f1(counts: Confusion) -> float:
    """Average the F1 of the classes, without classes that are neither true nor predicted anywhere."""
    totals = [sum(row) + sum(column) for row, column in zip(counts, zip(*counts, strict=True), strict=True)]
    scores = [2 * counts[number][number] / total for number, total in enumerate(totals) if total]
    return math.fsum(scores) / len(scores)


def _mean(values: NDArray[Any]) -> float:
    return math.fsum(values.ravel().tolist()) / values.size


def _rounded(metrics: Mapping[str, float]) -> dict[str, float]:
    return {name: rounded(value) for name, value in metrics.items()}
