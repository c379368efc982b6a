"""Promise: calibration is that of its definitions, and of scikit-learn where it has them."""

import numpy as np
import pytest
from scipy.special import softmax
from sklearn.calibration import calibration_curve
from sklearn.metrics import brier_score_loss, log_loss

from analysis.statistics.calibration import BINS, calibration, predicted, probabilities


def guesses(images: int = 200, classes: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Return probabilities that know a little of the classes."""
    rng = np.random.default_rng(0)
    truth = rng.integers(classes, size=images)
    return probabilities(2 * rng.normal(size=(images, classes)) + 2 * np.eye(classes)[truth]), truth


def test_calibration_by_hand() -> None:
    """Two images of 0.8, one of which is right, and one of 0.6 that is: gaps of 0.3 (twice) and 0.4 (once)."""
    chances, truth = np.array([[0.8, 0.2], [0.8, 0.2], [0.4, 0.6]]), np.array([0, 1, 1])
    found = calibration(chances, truth)
    assert found.accuracy == pytest.approx(2 / 3)
    assert found.ece == pytest.approx((2 * 0.3 + 0.4) / 3)
    assert found.brier == pytest.approx((2 * 0.2**2 + 2 * 0.8**2 + 2 * 0.4**2) / 3)
    assert [(one.images, one.confidence, one.accuracy) for one in found.bins] == [(1, 0.6, 1.0), (2, 0.8, 0.5)]


def test_scores_are_scikit_learns() -> None:
    """Brier's and the cross-entropy of four classes, and the reliability of two."""
    chances, truth = guesses()
    found, each = calibration(chances, truth), np.eye(4)[truth]
    assert found.cross_entropy == pytest.approx(log_loss(truth, chances))
    assert found.brier == pytest.approx(sum(brier_score_loss(each[:, k], chances[:, k]) for k in range(4)))
    sure, right = chances.max(axis=1), predicted(chances) == truth
    accuracies, confidences = calibration_curve(right, sure, n_bins=BINS)
    assert [one.accuracy for one in found.bins] == pytest.approx(accuracies)
    assert [one.confidence for one in found.bins] == pytest.approx(confidences)
    counts = np.histogram(sure, np.linspace(0, 1, BINS + 1))[0]
    gaps = np.abs(accuracies - confidences) @ counts[counts > 0] / len(truth)
    assert found.ece == pytest.approx(gaps)


def test_probabilities_are_scipys_softmax() -> None:
    """Without overflow; equal logits give equal probabilities, of which the first is predicted."""
    logits = np.random.default_rng(0).normal(size=(50, 5)) * 30
    assert probabilities(logits) == pytest.approx(softmax(logits, axis=1), abs=1e-12)
    assert probabilities([[1e30, 1e30, 0.0]]).tolist() == [[0.5, 0.5, 0.0]]
    assert predicted(np.array([[0.1, 0.1 + 0.2, 0.3, 0.3]])).tolist() == [1]


def test_certainty_is_in_the_last_bin_and_a_wrong_one_is_finite() -> None:
    """A confidence of 1 has no bin above, and its logarithm is cut off."""
    found = calibration(np.array([[1.0, 0.0], [1.0, 0.0]]), np.array([0, 1]))
    assert [(one.images, one.confidence) for one in found.bins] == [(2, 1.0)]
    assert found.cross_entropy == pytest.approx(-np.log(1e-12) / 2)
    assert (found.ece, found.brier) == (0.5, 1.0)


@pytest.mark.parametrize(("rows", "classes"), [(2, 1), (0, 0), (1, 2)])
def test_other_numbers_of_images_are_refused(rows: int, classes: int) -> None:
    """One class for each image, and an image at least."""
    with pytest.raises(ValueError, match="expected t x K"):
        calibration(np.full((rows, 2), 0.5), np.zeros(classes, np.int64))
