"""Promise: weights that come from a candidate's process are data, and those that were not trained are refused."""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import nn
from training_jobs import CONTRACT, RECIPE

from tacevo.choices import Numerics
from tacevo.records import Json, Limits, Reason, Rejection
from tacevo.sandbox.candidate import digest, send_weights
from tacevo.sandbox.client import AnswerError, Finished, Frame
from tacevo.training.evaluation import Examples, Setting
from tacevo.training.full import HeldOut
from tacevo.training.weights import Weighed, read_weights, train_and_weigh, weights_digest

VALUES = np.arange(6, dtype=np.float32)


def network() -> nn.Module:
    """Make one with buffers, a number without axes among them."""
    return nn.Sequential(nn.Conv2d(3, 2, 3), nn.BatchNorm2d(2))


def sent(model: nn.Module) -> Frame:
    """Send its weights as a trainer does."""
    frames: list[Frame] = []
    send_weights(model.state_dict(), lambda header, data: frames.append(Frame(json.loads(json.dumps(header)), data)))
    return frames[0]


def frame(*described: tuple[str, str, list[int]], payload: bytes = VALUES.tobytes()) -> Frame:
    """Make a frame by hand."""
    return Frame({"weights": [list(one) for one in described]}, payload)


def test_weights_come_as_they_were_sent() -> None:
    """Bit for bit, and with the digest that the trainer computes."""
    model = network()
    came = read_weights([sent(model)])
    assert came.keys() == model.state_dict().keys()
    assert all(torch.equal(torch.tensor(came[name]), value) for name, value in model.state_dict().items())
    assert weights_digest(came) == digest(model)


@pytest.mark.parametrize(
    "frames",
    [
        [],
        [frame(("a", "torch.float32", [6]))] * 2,
        [frame(("a", "torch.float32", [5]))],
        [frame(("a", "torch.float32", [7]))],
        [frame(("a", "torch.float32", [2**39, 2**39]))],
        [frame(("a", "torch.float32", [-1, -6]))],
        [frame(("a", "torch.complex64", [3]))],
        [frame(("a", "object", [6]))],
        [frame(("a", "torch.float32", [3]), ("a", "torch.float32", [3]))],
        [frame(("../a", "torch.float32", [6]))],
        [Frame({"weights": {"a": 1}}, b"")],
    ],
    ids=lambda frames: json.dumps([one.header for one in frames]),
)
def test_forged_frame_is_refused(frames: list[Frame]) -> None:
    """None, two, other sizes, types that are not plain, a name twice, a name that is a path, no list."""
    with pytest.raises((AnswerError, ValueError)):
        read_weights(frames)


def trained(change: Callable[[list[Frame]], list[Frame]], epoch: int = 1) -> Weighed | Rejection:
    """Have a process that can lie answer a training of one epoch."""
    model, rows = network(), np.arange(4)
    recipe = replace(RECIPE, epochs=1)
    targets: NDArray[Any] = np.zeros((2, CONTRACT.outputs), np.float32)
    examples = Examples(
        train=rows[:2],
        validation=rows[2:],
        train_targets=targets,
        validation_targets=targets,
        mean=(0.0,) * 3,
        deviation=(1.0,) * 3,
        fingerprint="f",
    )

    def run(entry: str, header: Json, payload: bytes, limits: Limits, *_: object) -> Finished:
        predictions = np.ones((4, CONTRACT.outputs), np.float32).tobytes()
        epochs = [Frame({"epoch": 0, "train_loss": 1.0, "steps": 1}, predictions)]
        return Finished(tuple(change([*epochs, Frame({"weights_sha256": digest(model)}, b""), sent(model)])))

    setting = Setting(contract=CONTRACT, fingerprint="f", recipe=recipe, numerics=Numerics.portable)
    held_out = HeldOut(rows=rows[:2], targets=targets, names=("a",), scale=(1.0,))
    return train_and_weigh(run, setting, "", 0, epoch=epoch, data=(examples, held_out))


def test_weights_are_those_of_the_digest() -> None:
    """Of the last epoch they are compared with the digest that the record has."""
    honest = trained(lambda frames: frames)
    assert isinstance(honest, Weighed)
    assert weights_digest(honest.weights) == honest.training.weights_sha256
    assert honest.predictions.shape == (2, CONTRACT.outputs)
    assert honest.training.predictions_sha256 != honest.tested.predictions_sha256
    other = sent(network())
    for change in (lambda frames: [*frames[:2], other], lambda frames: frames[:2], lambda frames: [*frames, other]):
        forged = trained(change)
        assert isinstance(forged, Rejection)
        assert forged.reason is Reason.bad_output
