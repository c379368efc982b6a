"""Promise: the parent's losses are the task losses, exact in any order, and rounded alike on every machine."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from torch.nn import functional

from tacevo.records import Loss
from tacevo.training.losses import cross_entropy, mean_squared_error, trivial_loss, validation_loss

VALUES = arrays(np.float32, (6, 3), elements=st.floats(-50, 50, width=32))
CLASSES = arrays(np.int64, (6,), elements=st.integers(0, 2))


def test_mean_squared_error_by_hand() -> None:
    """Errors 1, 2, 0 and 3 over four values: (1 + 4 + 0 + 9) / 4."""
    predictions = np.array([[1, 2], [3, 4]], np.float32)
    targets = np.array([[0, 4], [3, 1]], np.float32)
    assert mean_squared_error(predictions, targets) == 3.5


def test_cross_entropy_by_hand() -> None:
    """Equal logits over two classes cost log 2; odds of three to one cost log 4/3."""
    logits = np.array([[5, 5], [0, 0]], np.float32)
    logits[1, 0] = np.float32(math.log(3))
    expected = (math.log(2) + math.log(4 / 3)) / 2
    assert cross_entropy(logits, np.array([1, 0])) == pytest.approx(expected, rel=1e-6)


@given(targets=VALUES, constant=st.lists(st.floats(-50, 50, width=32), min_size=3, max_size=3))
def test_no_constant_is_better_than_the_trivial_loss(targets: NDArray[np.float32], constant: list[float]) -> None:
    """The mean of the targets has it, and every other value, the same for every image, has more."""
    lowest = trivial_loss(Loss.mse, targets)
    assert lowest == pytest.approx(targets.astype(np.float64).var(axis=0).mean(), rel=1e-6, abs=1e-9)
    same = np.tile(np.array(constant, np.float32), (len(targets), 1))
    assert validation_loss(Loss.mse, same, targets) >= lowest * (1 - 1e-6)


@given(classes=CLASSES, logits=arrays(np.float32, (3,), elements=st.floats(-9, 9, width=32)))
def test_no_constant_guess_is_better_than_the_trivial_loss(
    classes: NDArray[np.int64], logits: NDArray[np.float32]
) -> None:
    """The class frequencies have it; a class that no image has costs nothing."""
    lowest = trivial_loss(Loss.cross_entropy, classes)
    shares = np.bincount(classes, minlength=3) / len(classes)
    best = np.log(np.maximum(shares, 1e-30)).astype(np.float32)
    assert lowest == pytest.approx(validation_loss(Loss.cross_entropy, np.tile(best, (6, 1)), classes), abs=1e-6)
    assert validation_loss(Loss.cross_entropy, np.tile(logits, (6, 1)), classes) >= lowest - 1e-6


def test_trivial_loss_of_equal_classes_is_the_logarithm_of_their_number() -> None:
    """Ten materials: ln 10; one class alone: nothing."""
    assert trivial_loss(Loss.cross_entropy, np.arange(10).repeat(3)) == pytest.approx(math.log(10))
    assert math.copysign(1, trivial_loss(Loss.cross_entropy, np.zeros(4, np.int64))) == 1
    assert trivial_loss(Loss.cross_entropy, np.zeros(4, np.int64)) == 0


@given(predictions=VALUES, targets=VALUES, classes=CLASSES)
def test_losses_agree_with_torch(
    predictions: NDArray[np.float32], targets: NDArray[np.float32], classes: NDArray[np.int64]
) -> None:
    """The parent computes what the child minimises."""
    outputs = torch.from_numpy(predictions)
    squared = functional.mse_loss(outputs, torch.from_numpy(targets)).item()
    entropy = functional.cross_entropy(outputs, torch.from_numpy(classes)).item()
    assert mean_squared_error(predictions, targets) == pytest.approx(squared, rel=1e-5, abs=1e-6)
    assert cross_entropy(predictions, classes) == pytest.approx(entropy, rel=1e-5, abs=1e-6)


@given(logits=VALUES, classes=CLASSES, order=st.permutations(range(6)))
def test_order_of_the_examples_does_not_matter(
    logits: NDArray[np.float32],
    classes: NDArray[np.int64],
    order: list[int],
) -> None:
    """Sums are exact, so a permutation changes no bit."""
    assert cross_entropy(logits[order], classes[order]) == cross_entropy(logits, classes)
    assert mean_squared_error(logits[order], -logits[order]) == mean_squared_error(logits, -logits)


def test_extreme_logits_stay_finite() -> None:
    """The largest float32 values give a number, which a store can hold."""
    top = np.finfo(np.float32).max
    assert math.isfinite(cross_entropy(np.array([[top, -top]], np.float32), np.array([1])))
    assert math.isfinite(mean_squared_error(np.array([[top]], np.float32), np.array([[-top]], np.float32)))


def test_validation_loss_has_nine_digits() -> None:
    """A last bit that differs between two C libraries is rounded away."""
    logits = np.array([[0.1, 0.2, 0.7]], np.float32)
    assert validation_loss(Loss.cross_entropy, logits, np.array([2])) == 0.767949557
    assert validation_loss(Loss.mse, np.eye(3, dtype=np.float32), np.zeros((3, 3), np.float32)) == 0.333333333
