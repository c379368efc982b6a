"""The parent's side of a training: what is asked of the sandbox, and what its answer is worth.

An evaluation is a pure function of source, data, contract, recipe, seed and numerics, recalled from the store
under exactly these. The validation labels stay here: the child predicts, the parent computes the loss.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacevo.choices import Device, Numerics
from tacevo.errors import DataError
from tacevo.records import Contract, Json, Limits, Recipe, Rejection, Training, to_json
from tacevo.sandbox.client import Died, Finished
from tacevo.storage.store import Store
from tacevo.training.answers import read_answer, training_of

#: What the sandbox must offer for `Evaluator`, beside the array `images`.
ENTRIES = {"train": "tacevo.training.trainer:run"}

#: `Sandbox.run`, or anything that acts like it.
Run = Callable[[str, Json, bytes, Limits], Finished | Died]


@dataclass(frozen=True, eq=False, kw_only=True)
class Examples:
    """The rows and labels that a search trains and validates on; the images themselves lie in the sandbox."""

    #: Int64 rows of the training images, shape (n,).
    train: NDArray[np.int64]
    #: Int64 rows of the validation images, shape (m,).
    validation: NDArray[np.int64]
    #: Float32 of shape (n, K) for regression; int64 of shape (n,), each in [0, K), for classification.
    train_targets: NDArray[Any]
    #: The same for the validation images; never sent to a candidate.
    validation_targets: NDArray[Any]
    #: Per channel, in units of the stored values (0 to 255).
    mean: tuple[float, ...]
    #: Per channel, in the same units, positive.
    deviation: tuple[float, ...]
    #: The data set's, as in `tacevo.records.DataFacts`.
    fingerprint: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """What all trainings of one kind share: with source and seed, this is all that their results follow from."""

    contract: Contract
    #: Of the data set.
    fingerprint: str
    recipe: Recipe
    numerics: Numerics
    device: Device = Device.cpu

    def insist_on(self, examples: Examples) -> None:
        """Refuse examples of another data set.

        Raises:
            ValueError: the fingerprints differ.
        """
        if examples.fingerprint != self.fingerprint:
            raise ValueError(
                f"fingerprint must be that of the examples, {examples.fingerprint}; got {self.fingerprint}"
            )

    def request(self, source: str, seed: int, *, version: int) -> Json:
        """Write the question that a store keeps an evaluation under."""
        return {
            "version": version,
            "source": source,
            "data": self.fingerprint,
            "contract": to_json(self.contract),
            "recipe": to_json(self.recipe),
            "seed": seed,
            "numerics": self.numerics.value,
            **self._sent_device(),
        }

    def train(
        self, run: Run, source: str, seed: int, *, examples: Examples, predicted: Sequence[NDArray[np.int64]]
    ) -> Finished | Died:
        """Have a candidate trained in a sandbox.

        Args:
            run: `Sandbox.run`.
            source: text that defines the contract's class.
            seed: of the initial weights, the order of batches and dropout.
            examples: to train on.
            predicted: rows of the images to predict after each epoch, without their labels, in groups of which no
                two share a batch.
        """
        # Came later, and so enters messages only where there are several groups; a search has one.
        groups = {"groups": [len(rows) for rows in predicted]} if len(predicted) > 1 else {}
        rows = np.concatenate(predicted)
        header = {
            "source": source,
            "contract": to_json(self.contract),
            "recipe": to_json(self.recipe),
            "seed": seed,
            "mean": list(examples.mean),
            "deviation": list(examples.deviation),
            "train": len(examples.train),
            "validation": len(rows),
            **groups,
            **self._sent_device(),
        }
        payload = examples.train.tobytes() + rows.tobytes() + examples.train_targets.tobytes()
        return run("train", header, payload, self.recipe.limits)

    def _sent_device(self) -> dict[str, str]:
        # Came later, and so enters keys and messages only where it is set.
        return {} if self.device is Device.cpu else {"device": self.device.value}


class Evaluator:
    """Trains candidates, each once.

    Args:
        run: `Sandbox.run` of a sandbox that has `ENTRIES` and the array `images`.
        store: of the kind `evaluations`.
        setting: what all trainings share.
        examples: None where every answer is recorded, as in replay.
        rules: number of the trainer and of `judge` (`tacevo.rules.Rules.training`), part of every key.

    Raises:
        ValueError: the setting's fingerprint is not that of the examples.
    """

    def __init__(self, *, run: Run, store: Store, setting: Setting, examples: Examples | None, rules: int) -> None:
        if examples is not None:
            setting.insist_on(examples)
        self._run, self._store, self._setting, self._examples = run, store, setting, examples
        self._rules = rules

    def key(self, source: str, seed: int) -> str:
        """Name an evaluation: its key in the store."""
        return self._store.key(self._request(source, seed))

    def evaluate(self, source: str, seed: int) -> Training | Rejection:
        """Train a candidate, or recall how its training went.

        Args:
            source: text that defines the contract's class.
            seed: of the initial weights, the order of batches and dropout.

        Raises:
            CacheMissError: the store is in replay and holds no such evaluation.
            DataError: it must be trained, and there are no examples.
            SandboxError: the sandbox is broken; nothing is stored.
            StoreError: the store's entry is damaged.
        """
        answer = self._store.recall(self._request(source, seed), lambda: self._train(source, seed))
        return _verdict(answer)

    def retrain(self, source: str, seed: int) -> Training | Rejection:
        """Train a candidate whatever is recorded of it; nothing is stored.

        Raises:
            DataError: there are no examples.
            SandboxError: the sandbox is broken.
        """
        return _verdict(self._train(source, seed))

    def _request(self, source: str, seed: int) -> Json:
        return self._setting.request(source, seed, version=self._rules)

    def _train(self, source: str, seed: int) -> Json:
        """Have a candidate trained; give the store's answer."""
        examples, setting = self._examples, self._setting
        if examples is None:
            raise DataError(f"evaluation {self.key(source, seed)[:12]} is not recorded; load the data set to train it")
        outcome = setting.train(self._run, source, seed, examples=examples, predicted=[examples.validation])
        targets = examples.validation_targets
        verdict = judge(outcome, setting.contract, setting.recipe.epochs, targets, setting.device)
        return {"rejection" if isinstance(verdict, Rejection) else "training": to_json(verdict)}


def _verdict(answer: Json) -> Training | Rejection:
    """Read an answer as the store keeps it."""
    if "rejection" in answer:
        return Rejection.from_json(answer["rejection"])
    return Training.from_json(answer["training"])


def judge(
    outcome: Finished | Died, contract: Contract, epochs: int, targets: NDArray[Any], device: Device = Device.cpu
) -> Training | Rejection:
    """Hold a child's answer, of which nothing is trusted, against what a trainer sends; compute the losses.

    Args:
        outcome: what the sandbox gave.
        contract: for the loss and the number of outputs.
        epochs: how many were asked for.
        targets: of the validation images, as in `Examples`.
        device: what was trained on; on a CPU no operation may lack a deterministic form.
    """
    answer = read_answer(outcome, contract, epochs=epochs, rows=len(targets), device=device)
    return answer if isinstance(answer, Rejection) else training_of(answer, contract.loss, targets)
