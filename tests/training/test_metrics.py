"""Promise: test metrics are scikit-learn's, in nine digits, and edge cases are decided."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from sklearn.metrics import (
    accuracy_score,
    confusion_matrix,
    f1_score,
    log_loss,
    mean_absolute_error,
    mean_squared_error,
    r2_score,
)

from tacevo.records import Kind
from tacevo.training.metrics import (
    classification_metrics,
    confusion,
    macro_f1,
    metric_names,
    r_squared,
    regression_metrics,
)

NAMES = ("Fx", "Fy", "Fz")


def values(seed: int, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Draw float32 values."""
    return np.random.default_rng(seed).normal(0.5, 0.3, shape).astype(np.float32)


@given(st.integers(0, 10_000), st.integers(2, 40))
def test_regression_agrees_with_scikit_learn(seed: int, count: int) -> None:
    """Over all outputs and of each; R² over all is the plain mean, scikit-learn's default."""
    targets, predictions = values(seed, (count, 3)), values(seed + 1, (count, 3))
    metrics = regression_metrics(predictions, targets, names=NAMES, scale=(1.0, 2.0, 10.0))
    truth, guess = targets.astype(np.float64), predictions.astype(np.float64)
    assert metrics.keys() == metric_names(Kind.regression, NAMES)
    assert metrics["mse"] == pytest.approx(mean_squared_error(truth, guess), rel=1e-8)
    assert metrics["mae"] == pytest.approx(mean_absolute_error(truth, guess), rel=1e-8)
    assert metrics["rmse"] == pytest.approx(mean_squared_error(truth, guess) ** 0.5, rel=1e-8)
    assert metrics["r2"] == pytest.approx(r2_score(truth, guess), rel=1e-7)
    for name, column, expected in zip(NAMES, truth.T, guess.T, strict=True):
        assert metrics[f"mse_{name}"] == pytest.approx(mean_squared_error(column, expected), rel=1e-8)
        assert metrics[f"r2_{name}"] == pytest.approx(r2_score(column, expected), rel=1e-7)


def test_regression_by_hand() -> None:
    """Two images of one output: errors 1 and -3, targets 0 and 4, recorded in a unit of which 2 are one of training."""
    predictions, targets = np.array([[1], [1]], np.float32), np.array([[0], [4]], np.float32)
    metrics = regression_metrics(predictions, targets, names=("depth",), scale=(2.0,))
    assert (metrics["mse"], metrics["mae"], metrics["rmse"]) == (5.0, 2.0, 2.23606798)
    assert metrics["r2"] == metrics["r2_depth"] == -0.25
    assert (metrics["recorded_mae_depth"], metrics["recorded_rmse_depth"]) == (4.0, 4.47213595)


@pytest.mark.parametrize(("error", "expected"), [(0.0, 1.0), (0.1, 0.0)])
def test_output_without_variance_counts_as_in_scikit_learn(error: float, expected: float) -> None:
    """R² is 1 for perfect predictions of a constant and 0 for any other; never infinite, never NaN."""
    targets = np.full(5, 0.3)
    assert r_squared(np.full(5, error), targets) == expected == r2_score(targets, targets + error)


@given(st.integers(0, 10_000), st.integers(1, 40))
def test_classification_agrees_with_scikit_learn(seed: int, count: int) -> None:
    """With classes that are missing from truth, predictions or both, too."""
    logits = values(seed, (count, 5))
    classes = np.random.default_rng(seed).integers(0, 4, count)
    metrics, guess = classification_metrics(logits, classes), logits.argmax(axis=1)
    odds = np.exp(logits.astype(np.float64))
    assert metrics["accuracy"] == pytest.approx(accuracy_score(classes, guess), rel=1e-8)
    assert metrics["macro_f1"] == pytest.approx(f1_score(classes, guess, average="macro", zero_division=0), rel=1e-8)
    expected = log_loss(classes, odds / odds.sum(axis=1, keepdims=True), labels=range(5))
    assert metrics["cross_entropy"] == pytest.approx(expected, rel=1e-7)
    assert np.array_equal(confusion(logits, classes), confusion_matrix(classes, guess, labels=range(5)))


def test_confusion_has_true_classes_in_rows() -> None:
    """Three images of class 0, one of them taken for class 2; equal logits go to the first class."""
    logits = np.array([[1, 0, 0], [0, 0, 0], [0, 0, 1], [0, 1, 0]], np.float32)
    assert confusion(logits, np.array([0, 0, 0, 1])) == ((2, 0, 1), (0, 1, 0), (0, 0, 0))


def test_macro_f1_by_hand() -> None:
    """F1 of 4/5, 1 and 0; a fourth class that never occurs is left out."""
    counts = ((2, 0, 1, 0), (0, 1, 0, 0), (0, 0, 0, 0), (0, 0, 0, 0))
    assert macro_f1(counts) == pytest.approx((4 / 5 + 1 + 0) / 3)
