"""What a trainer's answer is worth: nothing of it is trusted, and the losses are computed here, in the parent."""

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacevo.choices import Device
from tacevo.records import Contract, Json, Loss, Reason, Rejection, Stage, Training
from tacevo.sandbox.client import Died, Finished, Frame
from tacevo.sandbox.protocol import one_line
from tacevo.training.losses import validation_loss

#: How torch spells an operation, as `training.determinism` notes it.
_OPERATION = re.compile(r"[\w:.]{1,100}", re.ASCII)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """A trainer's whole answer, well formed and finite."""

    #: Of each epoch, as the child reported it.
    train_losses: tuple[float, ...]
    #: Of each epoch, float32, shape (rows, K).
    predictions: tuple[NDArray[np.float32], ...]
    #: As the child reported it.
    weights_sha256: str
    #: See `Training`.
    not_deterministic: tuple[str, ...]


def read_answer(
    outcome: Finished | Died, contract: Contract, *, epochs: int, rows: int, device: Device = Device.cpu
) -> Answer | Rejection:
    """Hold a child's answer against what a trainer sends.

    Args:
        outcome: what the sandbox gave.
        contract: for the number of outputs.
        epochs: how many were asked for.
        rows: how many images were to be predicted.
        device: what was trained on; on a CPU no operation may lack a deterministic form.
    """
    if isinstance(outcome, Died):
        return _rejection(outcome.reason, outcome.detail)
    try:
        refused = _refusal(outcome.frames)
        if refused is not None:
            return refused
        *progress, last = outcome.frames
        answer = Answer(
            train_losses=tuple(_finite(frame.header["train_loss"]) for frame in progress),
            weights_sha256=_digest(last.header["weights_sha256"]),
            not_deterministic=_operations(last.header.get("not_deterministic", []), device),
            predictions=tuple(_matrix(frame.payload, rows, contract.outputs) for frame in progress),
        )
    except (ValueError, KeyError, TypeError, IndexError) as error:
        return _rejection(Reason.bad_output, f"the training's answer is malformed: {error}")
    count = len(answer.predictions)
    if count != epochs:
        return _rejection(Reason.bad_output, f"expected the predictions of {epochs} epochs; got {count}")
    for epoch, values in enumerate(answer.predictions, start=1):
        if not np.isfinite(values).all():
            return _rejection(Reason.not_finite, f"the predictions after epoch {epoch} are not all finite")
    return answer


def training_of(answer: Answer, loss: Loss, targets: NDArray[Any]) -> Training:
    """Compute the validation losses of an answer whose first predictions are those of the validation images.

    Args:
        answer: its predictions may go on with other images.
        loss: the task's.
        targets: of the validation images, as in `training.evaluation.Examples`.
    """
    count = len(targets)
    return Training(
        train_losses=answer.train_losses,
        validation_losses=tuple(validation_loss(loss, values[:count], targets) for values in answer.predictions),
        predictions_sha256=hashlib.sha256(b"".join(values.tobytes() for values in answer.predictions)).hexdigest(),
        weights_sha256=answer.weights_sha256,
        not_deterministic=answer.not_deterministic,
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
