"""The parent's side of a training: what the sandbox is asked, and how its answer is judged and stored.

An evaluation is a pure function of source, data, contract, recipe, seed and numerics, and exactly these are its key in
the store. The validation labels stay here: the child predicts, and the parent computes the loss.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from tacevo.choices import Device, Numerics
from tacevo.errors import DataError
from tacevo.records import Contract, Json, Recipe, Rejection, Training, to_json, written
from tacevo.sandbox.client import Died, Finished, RunJob
from tacevo.storage.store import Store
from tacevo.storage.verdicts import recall_verdict
from tacevo.training.answers import judge
from tacevo.training.losses import validation_loss

#: The entries that a sandbox needs for `Evaluator`, besides the array `images`.
ENTRIES = {"train": "tacevo.training.trainer:run"}
#: The job that comes before the first training on a GPU (`tacevo.training.gpu.look`).
LOOK = "look"
#: The entry that trainings on a GPU need besides.
ENTRIES_OF_GPUS = {LOOK: "tacevo.training.gpu:look"}
EQUIP = "tacevo.training.gpu:equip"

Data = TypeVar("Data")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False, kw_only=True)
class Examples:
    """The rows and labels that a search trains and validates on; the images themselves lie in the sandbox."""

    #: Int64 rows of the training images, shape (n,).
    train: NDArray[np.int64]
    #: Int64 rows of the validation images, shape (m,).
    validation: NDArray[np.int64]
    #: Float32 of shape (n, K) for regression; int64 of shape (n,), each in [0, K), for classification.
    train_targets: NDArray[Any]
    #: The targets of the validation images, of the same type; never sent to a candidate.
    validation_targets: NDArray[Any]
    #: The mean of each channel, in units of the stored values (0 to 255).
    mean: tuple[float, ...]
    #: The deviation of each channel, in the same units, positive.
    deviation: tuple[float, ...]
    #: The data set's, as in `tacevo.records.DataFacts`.
    fingerprint: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """The setting of all trainings of one kind. Their results follow from it, the source and the seed alone."""

    contract: Contract
    #: The fingerprint of the data set.
    fingerprint: str
    recipe: Recipe
    numerics: Numerics
    device: Device = Device.cpu
    #: Whether images keep torch's default memory layout, as before number 3 of the rules; the keys hold that number.
    contiguous: bool = False
    #: Whether square roots and their like are MKL's, as before number 5 of the rules.
    mkl_functions: bool = False

    def request(self, source: str, seed: int, *, version: int) -> Json:
        """Return the request that a store keeps an evaluation under."""
        return {
            "version": version,
            "source": source,
            "data": self.fingerprint,
            "contract": to_json(self.contract),
            "recipe": written(self.recipe),
            "seed": seed,
            "numerics": self.numerics.value,
            **self._sent_device(),
        }

    def train(
        self,
        run: RunJob,
        source: str,
        seed: int,
        *,
        examples: Examples,
        predicted: Sequence[NDArray[np.int64]],
        sent_epoch: int | None = None,
        last: bool = False,
    ) -> Finished | Died:
        """Train a candidate in a sandbox; the seed is that of the initial weights, the order of batches and dropout.

        After each epoch the images of the rows `predicted` are predicted, without their labels, in groups of which no
        two share a batch. With `last` only the first group is, the validation images; and all of them in the end, with
        the weights of the epoch of the lowest validation loss. The weights of an epoch, from 1, come last where they
        are asked for.

        Raises:
            ValueError: the examples are not those of the setting's fingerprint.
        """
        if examples.fingerprint != self.fingerprint:
            raise ValueError(f"expected examples with the fingerprint {self.fingerprint}; got {examples.fingerprint}")
        sizes, rows = [len(group) for group in predicted], np.concatenate(predicted)
        header: dict[str, Json] = {
            "source": source,
            "contract": to_json(self.contract),
            "recipe": written(self.recipe),
            "seed": seed,
            "mean": list(examples.mean),
            "deviation": list(examples.deviation),
            "train": len(examples.train),
            "validation": len(rows),
            # Sent only where they say something, so that the message of a search stays as it was.
            **({"groups": sizes} if len(sizes) > 1 else {}),
            **self._sent_device(),
            **({"contiguous": True} if self.contiguous else {}),
            **({"mkl_functions": True} if self.mkl_functions else {}),
            **({} if sent_epoch is None else {"sent_epoch": sent_epoch}),
            **({"last": True} if last else {}),
        }
        payload = examples.train.tobytes() + rows.tobytes() + examples.train_targets.tobytes()
        if not last:
            return run("train", header, payload, self.recipe.limits)
        score = partial(_score, self.contract, examples.validation_targets, self.recipe.epochs)
        return run("train", header, payload, self.recipe.limits, score)

    def judge(
        self, outcome: Finished | Died, examples: Examples, rows: int
    ) -> tuple[Training, tuple[NDArray[np.float32], ...]] | Rejection:
        """Judge the answer of such a training, which predicted so many rows, as `training.answers.judge` does."""
        recipe, device = self.recipe, self.device
        steps = max(1, len(examples.train) // recipe.batch_size)
        targets = examples.validation_targets
        return judge(outcome, self.contract, targets, epochs=recipe.epochs, steps=steps, rows=rows, device=device)

    def _sent_device(self) -> dict[str, str]:
        # Left out on a CPU, so that older keys and messages stay as they were.
        return {} if self.device is Device.cpu else {"device": self.device.value}


def _score(contract: Contract, targets: NDArray[Any], epochs: int, number: int, payload: bytes) -> float:
    """Return the validation loss of what a trainer sent after an epoch; infinity where it is not that, or after all."""
    if number >= epochs:
        return math.inf
    try:
        predictions = np.frombuffer(payload, np.float32).reshape(len(targets), contract.outputs)
    except ValueError:
        return math.inf
    return validation_loss(contract.loss, predictions, targets) if np.isfinite(predictions).all() else math.inf


class TrainingStore(ABC, Generic[Data, Result]):
    """Trains candidates, each with each seed once, and keeps the results.

    The sandbox has `ENTRIES` and the array `images`. Examples are None where every answer is recorded, as in a replay.
    `rules` is the number of the code that trains and judges, part of every key.
    """

    _result: type[Result]
    #: The name of the result in an entry of the store.
    _name: str

    def __init__(self, *, run: RunJob, store: Store, setting: Setting, examples: Data | None, rules: int) -> None:
        self._run, self._store, self._setting, self._examples = run, store, setting, examples
        self._rules = rules
        #: Source and seed of each training that was made here and took two.
        self.twice: set[tuple[str, int]] = set()

    def key(self, source: str, seed: int) -> str:
        """Return the key of a training in the store."""
        return self._store.key(self._request(source, seed))

    def is_recorded(self, source: str, seed: int) -> bool:
        """Return whether the store has a training, sound or not."""
        return self._store.holds(self.key(source, seed))

    def evaluate(self, source: str, seed: int) -> Result | Rejection:
        """Train a candidate with a seed, or recall how its training went.

        Raises:
            CacheMissError: the store is in replay and has no such training.
            DataError: it must be trained, and the examples are missing.
            SandboxError: the sandbox is broken; nothing is stored.
            StoreError: the store's entry is damaged.
        """
        request = self._request(source, seed)
        return recall_verdict(self._store, request, self._result, self._name, lambda: self.retrain(source, seed))

    def retrain(self, source: str, seed: int) -> Result | Rejection:
        """Train a candidate, recorded or not; nothing is stored.

        Raises:
            DataError: the examples are missing.
            SandboxError: the sandbox is broken.
        """
        if self._examples is None:
            place, remedy = f"training {self.key(source, seed)[:12]}", "load the data set to train it"
            raise DataError("no entry in the store", place=place, expected="a recorded answer", remedy=remedy)
        return self._train(self._examples, source, seed)

    def _request(self, source: str, seed: int) -> Json:
        return self._setting.request(source, seed, version=self._rules)

    @abstractmethod
    def _train(self, data: Data, source: str, seed: int) -> Result | Rejection:
        """Train a candidate in the sandbox and judge its answer."""


class Evaluator(TrainingStore[Examples, Training]):
    """The trainings of a search, in a store of the kind `evaluations`; its rules are `Rules.training`."""

    _result, _name = Training, "training"

    def _train(self, data: Examples, source: str, seed: int) -> Training | Rejection:
        outcome = self._setting.train(self._run, source, seed, examples=data, predicted=[data.validation])
        verdict = self._setting.judge(outcome, data, rows=len(data.validation))
        return verdict if isinstance(verdict, Rejection) else verdict[0]
