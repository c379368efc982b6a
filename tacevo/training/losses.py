"""The task losses as the parent computes them from a candidate's predictions.

They decide which candidate wins, so they must be equal on every machine. Sums are exact (`math.fsum`), and the result
is rounded to 9 significant digits, because `exp` and `log` of the C library may differ in their last bit between CPUs.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacevo.records import Loss
from tacevo.rounding import rounded


def validation_loss(loss: Loss, predictions: NDArray[np.float32], targets: NDArray[Any]) -> float:
    """Compute the task loss of finite predictions of shape (n, K), rounded to 9 significant digits.

    Targets are float32 of shape (n, K) for `mse`; int64 of shape (n,), each in [0, K), for `cross_entropy`.
    """
    exact = mean_squared_error if loss is Loss.mse else cross_entropy
    return rounded(exact(predictions, targets))


def trivial_loss(loss: Loss, targets: NDArray[Any]) -> float:
    """Return the lowest task loss that one and the same answer to every image can have, rounded as `validation_loss`.

    That answer is the mean of these very targets, whose loss is their variance, the mean over the outputs; or their
    class frequencies, whose loss is their entropy in nats. Targets are as of `validation_loss`.
    """
    if loss is Loss.cross_entropy:
        return rounded(entropy(np.bincount(targets).tolist()))
    means = [math.fsum(column) / len(column) for column in targets.T.tolist()]
    return rounded(mean_squared_error(np.tile(means, (len(targets), 1)), targets))


def entropy(counts: Sequence[int]) -> float:
    """Return the entropy in nats of classes that so many images have; a class without an image adds nothing."""
    total = sum(counts)
    return -math.fsum(count * math.log(count / total) for count in counts if count) / total + 0.0


def mean_squared_error(predictions: NDArray[np.floating], targets: NDArray[np.float32]) -> float:
    """Average the squared error over all values of shape (n, K)."""
    errors = predictions.astype(np.float64) - targets.astype(np.float64)
    return math.fsum((errors * errors).ravel().tolist()) / errors.size


def cross_entropy(logits: NDArray[np.float32], classes: NDArray[np.int64]) -> float:
    """Average, in nats, minus the log-probability that softmax gives to the true class.

    Logits are finite, of shape (n, K); classes are of shape (n,), each in [0, K).
    """
    rows = zip(logits.tolist(), classes.tolist(), strict=True)
    return math.fsum(_log_sum_exp(row) - row[true] for row, true in rows) / len(classes)


def _log_sum_exp(values: list[float]) -> float:
    """Compute log(sum(exp(values))) without overflow."""
    top = max(values)
    return top + math.log(math.fsum(math.exp(value - top) for value in values))
