"""The files `model.onnx` and `model.pt2` of trained networks: made in one confined process, checked in another.

This process never imports the class, and takes nothing of an answer on trust: a file must predict every test image as
the training did, in a process that has not run the class.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Len
from numpy.typing import NDArray

from tacevo.data.dataset import Dataset
from tacevo.errors import RunError
from tacevo.export.inert import check_onnx, check_pt2
from tacevo.records import Contract, Json, Limits, Record, to_json
from tacevo.sandbox.client import AnswerError, Died, Frame, Sandbox
from tacevo.training.weights import Weights

ENTRIES = {name: f"tacevo.export.converter:{name}" for name in ("convert", "check")}

EQUIP = "tacevo.export.converter:equip"

#: How far a file may be from the training, in parts of the largest output (of regression, before it is scaled). Sums in
#: another order gave at most a hundredth of it.
BOUND = 1e-4

#: Of one conversion or check.
_LIMITS = Limits(seconds=600, memory_mib=8192)

_REMEDY = "report it with the name of the candidate; its source is there by `tacevo show RUN CANDIDATE --source`"

Form = Literal["onnx", "pt2"]

FORMS: tuple[Form, ...] = ("onnx", "pt2")

#: Of the ONNX operators.
OPSET = 18


@dataclass(frozen=True, slots=True, kw_only=True)
class _Converted(Record):
    """What `convert` sends with a file."""

    arguments: tuple[str, ...]


_Times = Annotated[tuple[Annotated[float, Ge(0)], ...], Len(2, 1000)]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Checked(Record):
    """What `check` sends with the outputs."""

    #: By the number of images at once.
    milliseconds: dict[Literal["1", "32"], _Times]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Converted:
    """A file that predicts as the training did."""

    file: bytes
    #: Of the constructor, those that it has: a part of `Contract.offered`.
    arguments: tuple[str, ...]
    #: The largest difference from the training, as `BOUND` counts it.
    difference: float
    #: Of many passes, by the number of images at once.
    milliseconds: Mapping[str, Sequence[float]]


def convert(
    sandbox: Sandbox,
    form: Form,
    source: str,
    *,
    contract: Contract,
    data: Dataset,
    weights: Sequence[Weights],
    expected: NDArray[np.float64],
) -> Converted:
    """Make a file of networks and their weights, and check it on all test images.

    The sandbox has the entries, and the images of the data set; weights of several networks are an ensemble. What the
    file must predict has the shape (t, K), in units of the recording, or as probabilities.

    Raises:
        RunError: the network cannot be written so; or the file predicts something else.
        SandboxError: the sandbox is broken.
    """
    header: dict[str, Json] = {
        "format": form,
        "opset": OPSET,
        "source": source,
        "contract": to_json(contract),
        "weights": [[[name, f"torch.{v.dtype}", list(v.shape)] for name, v in one.items()] for one in weights],
        **{name: list(getattr(data, name)) for name in ("mean", "deviation", "scale", "offset")},
    }
    payload = b"".join(value.tobytes() for one in weights for value in one.values())
    made = _answer(sandbox, "convert", header, payload, f"model.{form}")
    try:
        arguments = made.read(_Converted).arguments
        if not set(arguments) <= contract.offered.keys():
            raise AnswerError(str(list(arguments)), expected=f"some of the arguments {list(contract.offered)}")
        (check_onnx if form == "onnx" else check_pt2)(made.payload)
        header = {"check": form, "rows": len(data.test)}
        answer = _answer(sandbox, "check", header, data.test.tobytes() + made.payload, f"model.{form}")
        milliseconds = answer.read(_Checked).milliseconds
        if milliseconds.keys() != {"1", "32"}:
            raise AnswerError(str(list(milliseconds)), expected="times of 1 and of 32 images")
        outputs = np.frombuffer(answer.payload, np.float32).reshape(expected.shape)
    except (AnswerError, ValueError) as error:
        raise RunError(str(error), place=f"model.{form}", expected="a file of the network", remedy=_REMEDY) from error
    return Converted(
        file=made.payload,
        arguments=arguments,
        difference=_difference(outputs, expected, data, f"model.{form}"),
        milliseconds={str(size): times for size, times in milliseconds.items()},
    )


def _answer(sandbox: Sandbox, entry: str, header: Json, payload: bytes, place: str) -> Frame:
    """Run a job that answers with one frame."""
    outcome = sandbox.run(entry, header, payload, _LIMITS)
    if isinstance(outcome, Died):
        raise RunError(
            f"{outcome.reason}: {outcome.detail}",
            place=place,
            expected="a network that can be written so",
            remedy=_REMEDY,
        )
    if len(outcome.frames) != 1:
        raise RunError(f"{len(outcome.frames)} answers", place=place, expected="one answer", remedy=_REMEDY)
    return outcome.frames[0]


def _difference(outputs: NDArray[np.float32], expected: NDArray[np.float64], data: Dataset, place: str) -> float:
    """Return the largest difference, in parts of the largest output.

    Raises:
        RunError: it is above `BOUND`.
    """
    scale, offset = (np.array(data.scale), np.array(data.offset)) if data.scale else (1.0, 0.0)
    apart = np.abs(outputs - expected) / scale
    largest = float(apart.max() / max(1e-30, np.abs((expected - offset) / scale).max()))
    if not largest <= BOUND:
        raise RunError(
            f"a difference of {largest:.3g}",
            place=place,
            expected=f"the outputs of the training to {BOUND:g} of the largest one",
            remedy="its outputs depend on more than its weights and the image, so it cannot be exported",
        )
    return largest
