"""The full training of a study: all epochs, then the test metrics of the epoch with the lowest validation loss.

The child predicts validation and test images after every epoch, in batches of their own, and is told none of their
labels; the parent chooses the epoch. So "the weights of the best validation epoch" needs no trust in the child, and a
network that normalises by the batch lets no test image touch a validation loss.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from tacevo.errors import DataError
from tacevo.records import Contract, Json, Kind, Rejection, Training, to_json
from tacevo.sandbox.client import Died, Finished
from tacevo.storage.store import Store
from tacevo.training.answers import read_answer, training_of
from tacevo.training.evaluation import Examples, Run, Setting
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
class FullTraining:
    """A full training and what its best epoch does on the test images."""

    #: Its `predictions_sha256` covers validation and test images; its `weights_sha256` is of the last epoch.
    training: Training
    #: Of the lowest validation loss, from 1; the first one on a tie.
    epoch: int
    #: By name, see `training.metrics`.
    metrics: Mapping[str, float]
    #: None for regression.
    confusion: Confusion | None

    @property
    def validation_loss(self) -> float:
        """The validation loss of the chosen epoch."""
        return self.training.validation_losses[self.epoch - 1]

    @classmethod
    def from_json(cls, value: Mapping[str, Json]) -> Self:
        """Read what `to_json` wrote."""
        counts = value["confusion"]
        return cls(
            training=Training.from_json(value["training"]),
            epoch=value["epoch"],
            metrics=value["metrics"],
            confusion=None if counts is None else tuple(tuple(row) for row in counts),
        )


class FullEvaluator:
    """Trains networks fully and tests them, each with each seed once.

    Args:
        run: `Sandbox.run` of a sandbox that has `evaluation.ENTRIES` and the array `images`.
        store: of the kind `studies`.
        setting: what all trainings share.
        examples: what is trained and validated on, and what is tested on; None where every answer is recorded.
        rules: number of the trainer, of `assess` and of the metrics (`tacevo.rules.STUDY`), part of every key.

    Raises:
        ValueError: the setting's fingerprint is not that of the examples.
    """

    def __init__(
        self, *, run: Run, store: Store, setting: Setting, examples: tuple[Examples, HeldOut] | None, rules: int
    ) -> None:
        if examples is not None:
            setting.insist_on(examples[0])
        self._run, self._store, self._setting, self._examples = run, store, setting, examples
        self._rules = rules

    def key(self, source: str, seed: int) -> str:
        """Name a full training: its key in the store."""
        return self._store.key(self._request(source, seed))

    def is_recorded(self, source: str, seed: int) -> bool:
        """Tell whether the store has a full training, sound or not."""
        return self._store.holds(self.key(source, seed))

    def evaluate(self, source: str, seed: int) -> FullTraining | Rejection:
        """Train and test a network, or recall how that went.

        Args:
            source: text that defines the contract's class.
            seed: of the initial weights, the order of batches and dropout.

        Raises:
            CacheMissError: the store is in replay and holds no such training.
            DataError: it must be trained, and there are no examples.
            SandboxError: the sandbox is broken; nothing is stored.
            StoreError: the store's entry is damaged.
        """
        answer = self._store.recall(self._request(source, seed), lambda: self._train(source, seed))
        return (
            Rejection.from_json(answer["rejection"])
            if "rejection" in answer
            else FullTraining.from_json(answer["full"])
        )

    def _request(self, source: str, seed: int) -> Json:
        return self._setting.request(source, seed, version=self._rules)

    def _train(self, source: str, seed: int) -> Json:
        """Have a network trained; give the store's answer."""
        if self._examples is None:
            raise DataError(f"training {self.key(source, seed)[:12]} is not recorded; load the data set to train it")
        examples, held_out = self._examples
        predicted = [examples.validation, held_out.rows]
        outcome = self._setting.train(self._run, source, seed, examples=examples, predicted=predicted)
        verdict = assess(outcome, self._setting, examples.validation_targets, held_out)
        return {"rejection" if isinstance(verdict, Rejection) else "full": to_json(verdict)}


def assess(
    outcome: Finished | Died, setting: Setting, validation_targets: NDArray[Any], held_out: HeldOut
) -> FullTraining | Rejection:
    """Choose the epoch of the lowest validation loss, the first on a tie, and compute its test metrics.

    Args:
        outcome: what the sandbox gave; its predictions are those of the validation images, then of the test images.
        setting: of the training.
        validation_targets: as in `Examples`.
        held_out: the test images.
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
