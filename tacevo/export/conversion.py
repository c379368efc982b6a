"""The file `model.onnx` of trained networks, and the class with its weights: each is tried on every test image.

This process never imports the class, and takes nothing of an answer on trust: the class must predict as its training
did, in a process of its own; the ONNX file is written anew from what was read of it, and must predict so in a process
that has not run the class.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Len
from numpy.typing import NDArray

from tacevo.data.dataset import Dataset
from tacevo.errors import RunError
from tacevo.export.onnx_file import rewritten
from tacevo.records import Contract, Json, Limits, Record, to_json
from tacevo.sandbox.client import AnswerError, Died, Frame, RunJob
from tacevo.training.weights import Weights

ENTRIES = {name: f"tacevo.export.converter:{name}" for name in ("predict", "convert", "check")}

EQUIP = "tacevo.export.converter:equip"

#: The largest difference of a file from the training, in parts of the largest output (of regression, before it is
#: scaled). Sums in another order gave at most a hundredth of it.
BOUND = 1e-4

#: The limits of one conversion or check.
_LIMITS = Limits(seconds=600, memory_mib=8192)

_REMEDY = "report it with the name of the candidate; its source is there by `tacevo show RUN CANDIDATE --source`"

#: The places that errors name.
_CLASS, _FILE = "model.py with its weights", "model.onnx"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Predicted(Record):
    """The header that `predict` sends with the outputs."""

    arguments: tuple[str, ...]


_Times = Annotated[tuple[Annotated[float, Ge(0)], ...], Len(2, 1000)]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Checked(Record):
    """The header that `check` sends with the outputs."""

    #: The times of passes, by the number of images at once.
    milliseconds: dict[Literal["1", "32"], _Times]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Networks:
    """Trained networks of one class as they are converted and checked."""

    source: str
    contract: Contract
    data: Dataset
    #: The weights of each network; several are an ensemble.
    weights: Sequence[Weights]
    #: The outputs of all of them together for the test images, shape (t, K), in units of the recording, or as
    #: probabilities.
    expected: NDArray[np.float64]

    @property
    def header(self) -> dict[str, Json]:
        """The header of a job, from which it builds the networks."""
        described = [[[name, f"torch.{v.dtype}", list(v.shape)] for name, v in one.items()] for one in self.weights]
        of_data = {name: list(getattr(self.data, name)) for name in ("mean", "deviation", "scale", "offset")}
        return {"source": self.source, "contract": to_json(self.contract), "weights": described, **of_data}

    @property
    def payload(self) -> bytes:
        """The bytes of all weights."""
        return b"".join(value.tobytes() for one in self.weights for value in one.values())

    def difference(self, payload: bytes, place: str) -> float:
        """Return the largest difference of outputs from what must come, in parts of the largest output.

        Raises:
            RunError: it is above `BOUND`, or these are not outputs.
        """
        try:
            outputs = np.frombuffer(payload, np.float32).reshape(self.expected.shape)
        except ValueError as error:
            raise _refusal(error, place) from error
        data = self.data
        scale, offset = (np.array(data.scale), np.array(data.offset)) if data.scale else (1.0, 0.0)
        apart = np.abs(outputs - self.expected) / scale
        largest = float(apart.max() / max(1e-30, np.abs((self.expected - offset) / scale).max()))
        if not largest <= BOUND:
            raise RunError(
                f"a difference of {largest:.3g}",
                place=place,
                expected=f"the outputs of the training to {BOUND:g} of the largest one",
                remedy="its outputs depend on more than its weights and the image" if place == _CLASS else "",
            )
        return largest


@dataclass(frozen=True, slots=True, kw_only=True)
class Built:
    """A class that predicts with its weights as the training did."""

    #: The arguments that the constructor takes: a part of `Contract.offered`.
    arguments: tuple[str, ...]
    #: The largest difference from the training, as `BOUND` counts it.
    difference: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Converted:
    """An ONNX file that predicts as the training did."""

    file: bytes
    #: The largest difference from the training, as `BOUND` counts it.
    difference: float
    #: The times of many passes, by the number of images at once.
    milliseconds: Mapping[str, Sequence[float]]


def check_class(run: RunJob, networks: Networks) -> Built:
    """Build the class with the weights, and compare what it says of all test images with the training.

    The job runs where `ENTRIES` and the images of the data set are.

    Raises:
        RunError: it says something else, so it cannot be exported.
        SandboxError: the sandbox is broken.
    """
    rows = networks.data.test
    answer = _answer(run, "predict", {**networks.header, "rows": len(rows)}, rows.tobytes() + networks.payload, _CLASS)
    try:
        arguments, offered = answer.read(_Predicted).arguments, networks.contract.offered
        if not set(arguments) <= offered.keys():
            raise AnswerError(str(list(arguments))[:200], expected=f"some of the arguments {list(offered)}")
    except AnswerError as error:
        raise _refusal(error, _CLASS) from error
    return Built(arguments=arguments, difference=networks.difference(answer.payload, _CLASS))


def convert(run: RunJob, networks: Networks) -> Converted:
    """Make an ONNX file of networks and their weights, and check it on all test images.

    Raises:
        RunError: ONNX cannot hold the network; or the file predicts something else, or is not a network alone.
        SandboxError: the sandbox is broken.
    """
    made = _answer(run, "convert", networks.header, networks.payload, _FILE)
    try:
        file = rewritten(made.payload, networks.contract)
    except ValueError as error:
        raise _refusal(error, _FILE) from error
    rows = networks.data.test
    checked: dict[str, Json] = {"rows": len(rows), "runs_onnx": True}
    answer = _answer(run, "check", checked, rows.tobytes() + file, _FILE)
    try:
        milliseconds = answer.read(_Checked).milliseconds
        if milliseconds.keys() != {"1", "32"}:
            raise AnswerError(str(list(milliseconds)), expected="times of 1 and of 32 images")
    except AnswerError as error:
        raise _refusal(error, _FILE) from error
    return Converted(
        file=file,
        difference=networks.difference(answer.payload, _FILE),
        milliseconds={str(size): times for size, times in milliseconds.items()},
    )


def _refusal(error: Exception, place: str) -> RunError:
    return RunError(str(error), place=place, expected="what a network sends", remedy=_REMEDY)


def _answer(run: RunJob, entry: str, header: Json, payload: bytes, place: str) -> Frame:
    """Run a job that answers with one frame."""
    outcome = run(entry, header, payload, _LIMITS)
    if isinstance(outcome, Died):
        got, expected = f"{outcome.reason}: {outcome.detail}", "a network that can be written so"
        raise RunError(got, place=place, expected=expected, remedy=_REMEDY)
    if len(outcome.frames) != 1:
        raise RunError(f"{len(outcome.frames)} answers", place=place, expected="one answer", remedy=_REMEDY)
    return outcome.frames[0]
