"""A trainer's answer, read and judged in the parent: nothing of it is trusted, and the losses are computed here."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import MaxLen
from numpy.typing import NDArray
from pydantic import StringConstraints

from tacevo.choices import Device
from tacevo.records import Contract, Loss, Reason, Record, Rejection, Stage, Training
from tacevo.sandbox.client import AnswerError, Died, Finished, Frame
from tacevo.sandbox.protocol import one_line
from tacevo.training.losses import validation_loss

#: How torch spells an operation, as `training.determinism` notes it. A summary shows it, so it is not free text.
_Operation = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_:.]{1,100}$")]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Epoch(Record):
    """What a trainer sends after an epoch, besides its predictions."""

    epoch: int
    train_loss: float
    #: Optimiser steps so far.
    steps: int


@dataclass(frozen=True, slots=True, kw_only=True)
class _Failure(Record):
    """Why a training ended early."""

    reason: Reason
    detail: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _End(Record):
    """What a trainer sends last: the digest of the trained weights, or why there is none."""

    weights_sha256: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")] = ""
    not_deterministic: Annotated[tuple[_Operation, ...], MaxLen(100)] = ()
    rejection: _Failure | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """A trainer's whole answer, well formed and finite."""

    #: Of each epoch, as the child reported them.
    train_losses: tuple[float, ...]
    #: Of each epoch, float32, shape (rows, K).
    predictions: tuple[NDArray[np.float32], ...]
    #: As the child reported it.
    weights_sha256: str
    #: See `Training`.
    not_deterministic: tuple[str, ...]


def read_answer(
    outcome: Finished | Died, contract: Contract, *, epochs: int, steps: int, rows: int, device: Device = Device.cpu
) -> Answer | Rejection:
    """Read a child's answer, of which nothing is trusted: predictions for a number of rows after each epoch.

    Each epoch must have the given number of optimiser steps. The child counts them, so this sees a candidate that has
    the trainer take more, and not one that resets the count. On a CPU no operation may lack a deterministic form.
    """
    if isinstance(outcome, Died):
        return _rejection(outcome.reason, outcome.detail)
    try:
        answer = _read(outcome.frames, (rows, contract.outputs), epochs, steps, device)
    except AnswerError:  # its text quotes the candidate, who may have written the frame
        return _rejection(Reason.bad_output, "expected a trainer's frames; got another frame")
    except ValueError as error:
        return _rejection(Reason.bad_output, str(error))
    if isinstance(answer, Rejection):
        return answer
    for epoch, values in enumerate(answer.predictions, start=1):
        if not np.isfinite(values).all():
            return _rejection(Reason.not_finite, f"the predictions after epoch {epoch} are not all finite")
    return answer


def training_of(answer: Answer, loss: Loss, targets: NDArray[Any]) -> Training:
    """Compute the validation losses of an answer whose first predictions are those of the validation images.

    The targets are those of `training.evaluation.Examples`.
    """
    count = len(targets)
    return Training(
        train_losses=answer.train_losses,
        validation_losses=tuple(validation_loss(loss, values[:count], targets) for values in answer.predictions),
        predictions_sha256=hashlib.sha256(b"".join(values.tobytes() for values in answer.predictions)).hexdigest(),
        weights_sha256=answer.weights_sha256,
        not_deterministic=answer.not_deterministic,
    )


def _read(
    frames: Sequence[Frame], shape: tuple[int, int], epochs: int, steps: int, device: Device
) -> Answer | Rejection:
    """Read a trainer's frames, each but the last with predictions of this shape and the steps so far.

    Raises:
        AnswerError, ValueError: they are not such frames.
    """
    if not frames:
        raise ValueError("expected at least one frame; got none")
    *progress, last = frames
    end = last.read(_End)
    if end.rejection is not None:
        return _rejection(end.rejection.reason, end.rejection.detail)
    operations = end.not_deterministic
    if list(operations) != sorted(set(operations)) or (operations and device is Device.cpu):
        raise ValueError("expected distinct operations in the order of their names, and none on a CPU; got others")
    if not end.weights_sha256 or len(progress) != epochs:
        raise ValueError(f"expected the predictions of {epochs} epochs and a digest; got those of {len(progress)}")
    reports = [frame.read(_Epoch) for frame in progress]
    counts, expected = [report.steps for report in reports], [number * steps for number in range(1, epochs + 1)]
    if counts != expected:
        raise ValueError(f"expected {steps} optimiser steps an epoch; got {counts} up to each epoch")
    return Answer(
        train_losses=tuple(report.train_loss for report in reports),
        predictions=tuple(np.frombuffer(frame.payload, np.float32).reshape(shape) for frame in progress),
        weights_sha256=end.weights_sha256,
        not_deterministic=operations,
    )


def _rejection(reason: Reason, detail: str) -> Rejection:
    return Rejection(stage=Stage.train, reason=reason, detail=one_line(detail))
