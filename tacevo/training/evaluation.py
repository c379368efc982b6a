"""The parent's side of a training: what is asked of the sandbox, and what its answer is worth.

An evaluation is a pure function of source, data, contract, recipe, seed and numerics, recalled from the store
under exactly these. The validation labels stay here: the child predicts, the parent computes the loss.
"""

import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacevo.choices import Device, Numerics
from tacevo.errors import DataError
from tacevo.records import Contract, Json, Limits, Reason, Recipe, Rejection, Stage, Training, to_json
from tacevo.sandbox.client import Died, Finished, Frame
from tacevo.sandbox.text import one_line
from tacevo.store import Store
from tacevo.training.losses import validation_loss

#: Enters every key; raise it with a change of the trainer or of `judge` that may change an answer.
TRAINING_VERSION = 1

#: What the sandbox must offer for `Evaluator`, beside the array `images`.
ENTRIES = {"train": "tacevo.training.trainer:run"}

#: How torch spells an operation, as `training.determinism` notes it.
_OPERATION = re.compile(r"[\w:.]{1,100}", re.ASCII)

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


class Evaluator:
    """Trains candidates, each once.

    Args:
        run: `Sandbox.run` of a sandbox that has `ENTRIES` and the array `images`.
        store: of the kind `evaluations`.
        contract: what a candidate must be.
        examples: None where every answer is recorded, as in replay.
        fingerprint: of the data set.
        recipe: how to train.
        numerics: of the sandbox's environment.
        device: what to train on.

    Raises:
        ValueError: the fingerprint is not that of the examples.
    """

    def __init__(
        self,
        *,
        run: Run,
        store: Store,
        contract: Contract,
        examples: Examples | None,
        fingerprint: str,
        recipe: Recipe,
        numerics: Numerics,
        device: Device = Device.cpu,
    ) -> None:
        if examples is not None and examples.fingerprint != fingerprint:
            raise ValueError(f"fingerprint must be that of the examples, {examples.fingerprint}; got {fingerprint}")
        self._run, self._store, self._examples = run, store, examples
        self._contract, self._recipe = contract, recipe
        self._fingerprint, self._numerics = fingerprint, numerics
        # Came later, and so enters keys only where it is set.
        self._sent_device = {} if device is Device.cpu else {"device": device.value}
        self._device = device

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
        return {
            "version": TRAINING_VERSION,
            "source": source,
            "data": self._fingerprint,
            "contract": to_json(self._contract),
            "recipe": to_json(self._recipe),
            "seed": seed,
            "numerics": self._numerics.value,
            **self._sent_device,
        }

    def _train(self, source: str, seed: int) -> Json:
        """Have a candidate trained; give the store's answer."""
        examples = self._examples
        if examples is None:
            raise DataError(f"evaluation {self.key(source, seed)[:12]} is not recorded; load the data set to train it")
        header = {
            "source": source,
            "contract": to_json(self._contract),
            "recipe": to_json(self._recipe),
            "seed": seed,
            "mean": list(examples.mean),
            "deviation": list(examples.deviation),
            "train": len(examples.train),
            "validation": len(examples.validation),
            **self._sent_device,
        }
        payload = examples.train.tobytes() + examples.validation.tobytes() + examples.train_targets.tobytes()
        outcome = self._run("train", header, payload, self._recipe.limits)
        verdict = judge(outcome, self._contract, self._recipe.epochs, examples.validation_targets, self._device)
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
    if isinstance(outcome, Died):
        return _rejection(outcome.reason, outcome.detail)
    try:
        refused = _refusal(outcome.frames)
        if refused is not None:
            return refused
        *progress, last = outcome.frames
        train_losses = tuple(_finite(frame.header["train_loss"]) for frame in progress)
        weights = _digest(last.header["weights_sha256"])
        not_deterministic = _operations(last.header.get("not_deterministic", []), device)
        predictions = [_matrix(frame.payload, len(targets), contract.outputs) for frame in progress]
    except (ValueError, KeyError, TypeError, IndexError) as error:
        return _rejection(Reason.bad_output, f"the training's answer is malformed: {error}")
    if len(predictions) != epochs:
        return _rejection(Reason.bad_output, f"expected the predictions of {epochs} epochs; got {len(predictions)}")
    for epoch, values in enumerate(predictions, start=1):
        if not np.isfinite(values).all():
            return _rejection(Reason.not_finite, f"the predictions after epoch {epoch} are not all finite")
    return Training(
        train_losses=train_losses,
        validation_losses=tuple(validation_loss(contract.loss, values, targets) for values in predictions),
        predictions_sha256=hashlib.sha256(b"".join(values.tobytes() for values in predictions)).hexdigest(),
        weights_sha256=weights,
        not_deterministic=not_deterministic,
    )


def _refusal(frames: Sequence[Frame]) -> Rejection | None:
    """Read the rejection that a trainer sends as its last frame, if it did."""
    problem = frames[-1].header.get("rejection") if frames and isinstance(frames[-1].header, dict) else None
    return None if problem is None else _rejection(Reason(problem["reason"]), str(problem["detail"]))


def _rejection(reason: Reason, detail: str) -> Rejection:
    return Rejection(stage=Stage.train, reason=reason, detail=one_line(detail))


def _finite(value: Json) -> float:
    if not isinstance(value, float):
        raise TypeError(f"expected a number; got {type(value).__name__}")
    return value  # finite: no message may hold anything else


def _digest(value: Json) -> str:
    if not isinstance(value, str) or not re.fullmatch(r"[0-9a-f]{64}", value):
        raise ValueError("expected a SHA-256 in hex")
    return value


def _operations(value: Json, device: Device) -> tuple[str, ...]:
    """Read the names of operations without a deterministic form; a summary shows them, so they are no free text."""
    if value and device is Device.cpu:
        raise ValueError("expected no operation without a deterministic form, since a CPU runs none")
    if not isinstance(value, list) or len(value) > 100 or not all(_is_operation(name) for name in value):
        raise ValueError("expected at most 100 names of operations")
    if value != sorted(set(value)):
        raise ValueError("expected distinct names of operations in their order")
    return tuple(value)


def _is_operation(name: Json) -> bool:
    return isinstance(name, str) and _OPERATION.fullmatch(name) is not None


def _matrix(payload: bytes, rows: int, columns: int) -> NDArray[np.float32]:
    """Read float32 values of shape (rows, columns)."""
    return np.frombuffer(payload, np.float32).reshape(rows, columns)
