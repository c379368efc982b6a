"""The full training of a study: all epochs, then the test metrics of the epoch with the lowest validation loss.

The child predicts validation and test images after every epoch, in separate batches and without their labels; the
parent chooses the epoch. So "the weights of the best validation epoch" needs no trust in the child, and in a network
that normalises by the batch no test image changes a validation loss.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacevo.records import Contract, Kind, Record, Rejection, Training
from tacevo.sandbox.client import Died, Finished
from tacevo.training.answers import read_answer, training_of
from tacevo.training.evaluation import Examples, Setting, TrainingStore
from tacevo.training.metrics import Confusion, classification_metrics, confusion, regression_metrics


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOut:
    """The test images: their rows and labels, which no search has."""

    #: Int64, shape (t,).
    rows: NDArray[np.int64]
    #: Float32 of shape (t, K) for regression; int64 of shape (t,), each in [0, K), for classification.
    targets: NDArray[Any]
    #: Of the regressed values or classes, K.
    names: tuple[str, ...]
    #: Units of the recording for one unit of training, K; empty for classification.
    scale: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class FullTraining(Record):
    """A full training, and the test metrics of its best epoch."""

    #: Its `predictions_sha256` covers validation and test images; its `weights_sha256` is of the last epoch.
    training: Training
    #: Of the lowest validation loss, from 1; the first one on a tie.
    epoch: int
    #: By name, see `training.metrics`.
    metrics: dict[str, float]
    #: None for regression.
    confusion: Confusion | None

    @property
    def validation_loss(self) -> float:
        """The validation loss of the chosen epoch."""
        return self.training.validation_losses[self.epoch - 1]


class FullEvaluator(TrainingStore[tuple[Examples, HeldOut], FullTraining]):
    """The full trainings of studies, in a store of the kind `studies`; their rules are `tacevo.rules.STUDY`."""

    _result, _name = FullTraining, "full"

    def _train(self, data: tuple[Examples, HeldOut], source: str, seed: int) -> FullTraining | Rejection:
        examples, held_out = data
        predicted = [examples.validation, held_out.rows]
        outcome = self._setting.train(self._run, source, seed, examples=examples, predicted=predicted)
        return assess(outcome, self._setting, examples.validation_targets, held_out)


def assess(
    outcome: Finished | Died, setting: Setting, validation_targets: NDArray[Any], held_out: HeldOut
) -> FullTraining | Rejection:
    """Choose the epoch of the lowest validation loss, the first on a tie, and compute its test metrics.

    The predictions are those of the validation images, then of the test images.
    """
    contract, count = setting.contract, len(validation_targets)
    rows, epochs = count + len(held_out.rows), setting.recipe.epochs
    answer = read_answer(outcome, contract, epochs=epochs, rows=rows, device=setting.device)
    if isinstance(answer, Rejection):
        return answer
    training = training_of(answer, contract.loss, validation_targets)
    best = min(range(epochs), key=training.validation_losses.__getitem__)
    predictions = answer.predictions[best][count:]
    return FullTraining(
        training=training,
        epoch=best + 1,
        metrics=_metrics(contract, predictions, held_out),
        confusion=confusion(predictions, held_out.targets) if contract.kind is Kind.classification else None,
    )


def _metrics(contract: Contract, predictions: NDArray[np.float32], held_out: HeldOut) -> dict[str, float]:
    if contract.kind is Kind.classification:
        return classification_metrics(predictions, held_out.targets)
    return regression_metrics(predictions, held_out.targets, names=held_out.names, scale=held_out.scale)
