"""A training whose weights are kept: the same training as a search's or a study's, from which the weights come too.

They come as plain bytes with names, types and shapes, and nothing of them is trusted: sizes are checked, and the digest
of the last epoch's is computed here again.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import Annotated

import numpy as np
from annotated_types import Ge, Lt, MaxLen
from numpy.typing import NDArray
from pydantic import StringConstraints

from tacevo.records import Reason, Record, Rejection, Stage, Training
from tacevo.sandbox.client import AnswerError, Finished, Frame, RunJob
from tacevo.sandbox.protocol import one_line
from tacevo.training.evaluation import Examples, Setting
from tacevo.training.full import HeldOut, untested

#: Weights and buffers by name; a plain array each.
Weights = Mapping[str, NDArray[np.generic]]

#: The types that a weight may have, by their names in torch, with those in NumPy.
TYPES = {
    f"torch.{name}": np.dtype(name)
    for name in ("float32", "float64", "float16", "int64", "int32", "int16", "int8", "uint8", "bool")
}

_Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_.]{1,500}$")]

_Size = Annotated[int, Ge(0), Lt(2**40)]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sent(Record):
    """The message that a trainer sends with the bytes of the weights: name, type and shape of each."""

    weights: Annotated[tuple[tuple[_Name, str, tuple[_Size, ...]], ...], MaxLen(100_000)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Weighed:
    """A training with the weights of one epoch."""

    #: The training on the training and validation images alone, as a search records it, and a study under today's
    #: rules.
    training: Training
    #: The training as studies under the rules before `tacevo.rules.CHOSEN_SINCE` record it: its digest covers the
    #: predictions of the test images, too.
    tested: Training
    weights: Weights
    #: The predictions of the test images after that epoch, float32, shape (t, K), in the scaled units of training, or
    #: logits.
    predictions: NDArray[np.float32]


def train_and_weigh(
    run: RunJob, setting: Setting, source: str, seed: int, *, epoch: int, data: tuple[Examples, HeldOut]
) -> Weighed | Rejection:
    """Train a network in a sandbox and keep its weights after an epoch, from 1; nothing is stored.

    Predicting test images changes no bit of a training, so it is that of a search as well as that of a study.

    Raises:
        SandboxError: the sandbox is broken.
    """
    examples, held_out = data
    predicted = [examples.validation, held_out.rows]
    outcome = setting.train(run, source, seed, examples=examples, predicted=predicted, sent_epoch=epoch)
    sent: tuple[Frame, ...] = ()
    if isinstance(outcome, Finished):
        sent = tuple(frame for frame in outcome.frames if isinstance(frame.header, dict) and "weights" in frame.header)
        outcome = replace(outcome, frames=tuple(frame for frame in outcome.frames if frame not in sent))
    verdict = setting.judge(outcome, examples, rows=sum(map(len, predicted)))
    if isinstance(verdict, Rejection):
        return verdict
    tested, of_epochs = verdict
    try:
        weights = read_weights(sent)
        if epoch == setting.recipe.epochs and (came := weights_digest(weights)) != tested.weights_sha256:
            raise ValueError(f"expected weights of the digest {tested.weights_sha256[:12]}; got {came[:12]}")
    except (AnswerError, ValueError) as error:
        return Rejection(stage=Stage.train, reason=Reason.bad_output, detail=one_line(str(error)))
    count = len(examples.validation)
    return Weighed(
        training=untested(tested, of_epochs, count),
        tested=tested,
        weights=weights,
        predictions=of_epochs[epoch - 1][count:],
    )


def read_weights(frames: Sequence[Frame]) -> Weights:
    """Read the one frame of `tacevo.sandbox.candidate.send_weights`.

    Raises:
        AnswerError, ValueError: it is another number, or not such a frame.
    """
    if len(frames) != 1:
        raise ValueError(f"expected weights once; got them {len(frames)} times")
    [frame] = frames
    weights: dict[str, NDArray[np.generic]] = {}
    at = 0
    for name, kind, shape in frame.read(_Sent).weights:
        if name in weights or kind not in TYPES:
            raise ValueError(f"expected weights of distinct names and of plain types; got {name}, {kind}")
        size = prod(shape)
        if size > len(frame.payload):
            raise ValueError(f"expected as many bytes as the shapes say; got {len(frame.payload)}")
        weights[name] = np.frombuffer(frame.payload, TYPES[kind], size, at).reshape(shape)
        at += size * TYPES[kind].itemsize
    if at != len(frame.payload):
        raise ValueError(f"expected {at} bytes of weights; got {len(frame.payload)}")
    return weights


def weights_digest(weights: Weights) -> str:
    """Hash weights as `tacevo.sandbox.candidate.digest` does: 64 hex digits of SHA-256."""
    total = hashlib.sha256()
    for name, value in sorted(weights.items()):
        total.update(f"{name} torch.{value.dtype} {value.shape}\n".encode())
        total.update(value.tobytes())
    return total.hexdigest()
