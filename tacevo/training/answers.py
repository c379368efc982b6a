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
from tacevo.records import Contract, Reason, Record, Rejection, Stage, Training
from tacevo.sandbox.client import AnswerError, Died, Finished, Frame
from tacevo.sandbox.protocol import one_line
from tacevo.training.losses import validation_loss

#: The name of an operation as torch spells it, and as `training.determinism` notes it. A summary shows it, so it is not
#: free text.
_Operation = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_:.]{1,100}$")]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Epoch(Record):
    """The message of a trainer after an epoch, besides its predictions."""

    epoch: int
    train_loss: float
    #: Optimiser steps so far.
    steps: int


@dataclass(frozen=True, slots=True, kw_only=True)
class _Failure(Record):
    """The reason why a training ended early."""

    reason: Reason
    detail: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _End(Record):
    """The last message of a trainer: the digest of the trained weights, or why there is none."""

    weights_sha256: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")] = ""
    not_deterministic: Annotated[tuple[_Operation, ...], MaxLen(100)] = ()
    captured: bool | None = None
    rejection: _Failure | None = None


def judge(
    outcome: Finished | Died,
    contract: Contract,
    targets: NDArray[Any],
    *,
    epochs: int,
    steps: int,
    rows: int,
    device: Device = Device.cpu,
) -> tuple[Training, tuple[NDArray[np.float32], ...]] | Rejection:
    """Read a child's answer, of which nothing is trusted, and compute the validation losses.

    After each epoch it predicts so many rows, first the validation images, whose targets are as in
    `training.evaluation.Examples`. Each epoch must have the given number of optimiser steps. The child counts them, so
    this sees a candidate that has the trainer take more, and not one that resets the count. On a CPU no operation may
    lack a deterministic form.

    Returns:
        The training, and the predictions of each epoch: float32, shape (rows, K), finite.
    """
    if isinstance(outcome, Died):
        return _rejection(outcome.reason, outcome.detail)
    try:
        end, losses, predictions = _read(outcome.frames, (rows, contract.outputs), epochs, steps, device)
    except AnswerError:  # its text quotes the candidate, who may have written the frame
        return _rejection(Reason.bad_output, "expected a trainer's frames; got another frame")
    except ValueError as error:
        return _rejection(Reason.bad_output, str(error))
    if end.rejection is not None:
        return _rejection(end.rejection.reason, end.rejection.detail)
    for epoch, values in enumerate(predictions, start=1):
        if not np.isfinite(values).all():
            return _rejection(Reason.not_finite, f"the predictions after epoch {epoch} are not all finite")
    training = Training(
        train_losses=losses,
        validation_losses=tuple(
            validation_loss(contract.loss, values[: len(targets)], targets) for values in predictions
        ),
        predictions_sha256=hashlib.sha256(b"".join(values.tobytes() for values in predictions)).hexdigest(),
        weights_sha256=end.weights_sha256,
        not_deterministic=end.not_deterministic,
        captured=end.captured,
    )
    return training, predictions


def _read(
    frames: Sequence[Frame], shape: tuple[int, int], epochs: int, steps: int, device: Device
) -> tuple[_End, tuple[float, ...], tuple[NDArray[np.float32], ...]]:
    """Read a trainer's frames: the last, and the losses and predictions of each epoch; none where it was rejected.

    Raises:
        AnswerError, ValueError: they are not such frames.
    """
    if not frames:
        raise ValueError("expected at least one frame; got none")
    *progress, last = frames
    end = last.read(_End)
    if end.rejection is not None:
        return end, (), ()
    operations = end.not_deterministic
    if list(operations) != sorted(set(operations)) or (operations and device is Device.cpu):
        raise ValueError("expected distinct operations in the order of their names, and none on a CPU; got others")
    if end.captured is not None and device is Device.cpu:
        raise ValueError("expected no captured steps on a CPU; got some")
    if not end.weights_sha256 or len(progress) != epochs:
        raise ValueError(f"expected the predictions of {epochs} epochs and a digest; got those of {len(progress)}")
    reports = [frame.read(_Epoch) for frame in progress]
    counts, expected = [report.steps for report in reports], [number * steps for number in range(1, epochs + 1)]
    if counts != expected:
        raise ValueError(f"expected {steps} optimiser steps an epoch; got {counts} up to each epoch")
    predictions = tuple(np.frombuffer(frame.payload, np.float32).reshape(shape) for frame in progress)
    return end, tuple(report.train_loss for report in reports), predictions


def _rejection(reason: Reason, detail: str) -> Rejection:
    return Rejection(stage=Stage.train, reason=reason, detail=one_line(detail))
