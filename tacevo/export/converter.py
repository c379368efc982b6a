"""Makes and tries the files of a network, inside the sandbox: the entries `predict`, `convert`, `check`, and `equip`.

`predict` and `convert` run the candidate's class. `check` does not: it gets a finished file and runs that, so the one
that made it cannot speak for it. What libraries read of files when they are first used, they read before a process is
confined.
"""

import functools
import gc
import importlib
import sys
import timeit
from collections.abc import Callable
from typing import Any

import numpy as np
import onnxscript._internal.ast_utils as onnxscript_sources
import torch
from numpy.typing import NDArray
from torch import nn

from tacevo.export.onnx_file import INPUT, OPSET, OUTPUT
from tacevo.records import Contract, Kind
from tacevo.sandbox.candidate import build
from tacevo.sandbox.child import Arrays, Send
from tacevo.sandbox.module_parts import state, switch
from tacevo.sandbox.protocol import Header

#: Another seed than that of any training: what a network draws and does not keep among its weights must not matter.
_SEED = 0

#: Images that are predicted at once.
_BATCH = 32

#: The number of passes of a batch that are timed, after a tenth as many that are not.
_REPEATS = 40

# Torch looks for these for every model, and does without them; a candidate's process would have to run again below a
# zygote that has imported more, which takes as long as all else.
for _absent in ("torchvision", "tabulate"):
    sys.modules[_absent] = None  # type: ignore[assignment]  # an import of it fails at once

# It reads the sources of its own functions for every model, and no candidate's process can.
onnxscript_sources.get_src_and_ast = functools.cache(onnxscript_sources.get_src_and_ast)


class _Whole(nn.Module):
    """The mean over the networks: from raw images, float32 in [0, 255], to units of the recording or probabilities."""

    mean: torch.Tensor
    deviation: torch.Tensor
    scale: torch.Tensor
    offset: torch.Tensor

    def __init__(self, networks: list[nn.Module], header: Header) -> None:
        super().__init__()
        self.networks = nn.ModuleList(networks)
        for name in ("mean", "deviation"):
            self.register_buffer(name, torch.tensor(header[name], dtype=torch.float32)[:, None, None])
        for name in ("scale", "offset"):
            self.register_buffer(name, torch.tensor(header[name], dtype=torch.float32))
        self._is_regression = header["contract"]["kind"] == Kind.regression.value

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        # A network may write to its input, so each gets its own.
        outputs = [network((images - self.mean) / self.deviation) for network in self.networks]
        if self._is_regression:
            parts = [output * self.scale + self.offset for output in outputs]
        else:
            parts = [torch.softmax(output, dim=1) for output in outputs]
        return torch.stack(parts).mean(dim=0) if len(parts) > 1 else parts[0]


def equip(header: Header, payload: bytes, arrays: Arrays) -> Arrays:
    """Import onnxruntime where a file of it is checked: it starts a thread, and a zygote may have only one."""
    if header.get("runs_onnx"):
        importlib.import_module("onnxruntime")
    return arrays


def predict(header: Header, payload: bytes, arrays: Arrays, send: Send) -> object:
    """Build networks with their weights, and run them on images of the data set.

    Args:
        header: as of `convert`; and `rows`, the number of images that are predicted.
        payload: int64 rows of these images, then the bytes of all weights.
        arrays: `images`, uint8 of shape (N, C, S, S).
        send: takes `{"arguments": [...]}`, those that the constructor took, and the outputs, float32 of shape
            (rows, K).
    """
    rows = np.frombuffer(payload, np.int64, header["rows"])
    whole, arguments = _build(header, payload[rows.nbytes :])

    def run(images: NDArray[np.float32]) -> NDArray[Any]:
        with torch.no_grad():
            return np.asarray(whole(torch.from_numpy(images)))

    send({"arguments": arguments}, _predicted(run, arrays, rows).tobytes())
    return whole


def convert(header: Header, payload: bytes, arrays: Arrays, send: Send) -> object:
    """Write networks with their weights as one ONNX file; send it.

    Args:
        header: `source`; `contract`; `weights`, for each network a list of name, type as torch names it, and shape;
            `mean` and `deviation` per channel, in units of the stored values; `scale` and `offset` per output, empty
            for classification.
        payload: the bytes of all weights.
        arrays: not used.
        send: takes `{}` and the file.
    """
    whole, _ = _build(header, payload)
    send({}, _write(whole, Contract.from_json(header["contract"])))
    return whole


def check(header: Header, payload: bytes, arrays: Arrays, send: Send) -> object:
    """Let ONNX check a file, run it on images of the data set, then time it.

    Args:
        header: `rows`, the number of images that are predicted; `runs_onnx`.
        payload: int64 rows of these images, then the file.
        arrays: `images`, uint8 of shape (N, C, S, S).
        send: takes `{"milliseconds": {"1": [...], "32": [...]}}`, by the number of images at once, and the outputs,
            float32 of shape (rows, K).
    """
    rows = np.frombuffer(payload, np.int64, header["rows"])
    checker: Any = importlib.import_module("onnx.checker")
    checker.check_model(payload[rows.nbytes :], full_check=True)
    model = _onnx(payload[rows.nbytes :])
    outputs = _predicted(model, arrays, rows)
    timed = {str(size): _times(model, _pixels(arrays, np.resize(rows, size))) for size in (1, _BATCH)}
    send({"milliseconds": timed}, outputs.tobytes())
    return model


def _build(header: Header, payload: bytes) -> tuple[nn.Module, list[str]]:
    """Build the whole model of a header, in evaluation; return it with the arguments that the constructor took."""
    contract = Contract.from_json(header["contract"])
    networks: list[nn.Module] = []
    at = 0
    for described in header["weights"]:
        networks.append(build(header["source"], contract, _SEED))
        at = _load(networks[-1], described, payload, at)
    whole = _Whole(networks, header)
    switch(whole, training=False)
    return whole, list(contract.arguments(type(networks[0])))


def _load(network: nn.Module, described: list[Any], payload: bytes, at: int) -> int:
    """Copy weights into a network, without calling it; return where the next begin.

    Raises:
        ValueError: they are not those of this class.
    """
    own = state(network)
    if own.keys() != {name for name, _, _ in described}:
        raise ValueError("expected weights of the names that the class makes")
    for name, kind, shape in described:
        if str(own[name].dtype) != kind or list(own[name].shape) != shape:
            raise ValueError(f"expected {kind} of shape {shape} for {name}; the class makes another")
        value = torch.from_numpy(np.frombuffer(payload, kind.removeprefix("torch."), own[name].numel(), at).copy())
        at += value.nbytes
        with torch.no_grad():
            torch.Tensor.copy_(own[name], value.reshape(shape))
    return at


def _write(whole: nn.Module, contract: Contract) -> bytes:
    """Write a model for any number of images as ONNX."""
    size = contract.image_size
    images = torch.zeros(2, contract.in_channels, size, size)
    program = torch.export.export(whole, (images,), dynamic_shapes=({0: torch.export.Dim("batch")},))
    program = program.run_decompositions({torch.ops.aten.adaptive_max_pool2d.default: _adaptive_max_pool2d})
    try:
        made: Any = torch.onnx.export(
            program, dynamo=True, opset_version=OPSET, input_names=[INPUT], output_names=[OUTPUT], verbose=False
        )
    except torch.onnx.errors.OnnxExporterError as error:
        cause: BaseException = error
        while cause.__cause__ is not None:  # the first names the operator, the last gives advice for torch's authors
            cause = cause.__cause__
        raise ValueError(str(cause)) from None
    data: bytes = made.model_proto.SerializeToString(deterministic=True)
    return data


def _adaptive_max_pool2d(images: torch.Tensor, size: list[int]) -> tuple[torch.Tensor, torch.Tensor]:
    """Pool as torch does, whose export to ONNX has no such operator; places of the largest are not told."""
    for axis, count in zip((-2, -1), size, strict=True):
        length = images.shape[axis]
        ends = [(cell * length // count, -((cell + 1) * -length // count)) for cell in range(count)]
        images = torch.stack([images.narrow(axis, begin, end - begin).amax(axis) for begin, end in ends], axis)
    return images, torch.zeros_like(images, dtype=torch.int64)


def _onnx(file: bytes) -> Callable[[NDArray[np.float32]], NDArray[Any]]:
    runtime: Any = importlib.import_module("onnxruntime")
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = runtime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    return lambda images: session.run(None, {INPUT: images})[0]


def _predicted(
    model: Callable[[NDArray[np.float32]], NDArray[Any]], arrays: Arrays, rows: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Run a model on images, some at once."""
    parts = [model(_pixels(arrays, rows[i : i + _BATCH])) for i in range(0, len(rows), _BATCH)]
    return np.concatenate(parts).astype(np.float32)


def _pixels(arrays: Arrays, rows: NDArray[np.int64]) -> NDArray[np.float32]:
    return np.asarray(arrays["images"][rows], np.float32)


def _times(model: Callable[[NDArray[np.float32]], NDArray[Any]], images: NDArray[np.float32]) -> list[float]:
    """Time a model on the same images many times, in milliseconds."""
    timer = timeit.Timer(lambda: model(images), setup=gc.enable)  # as in a user's program
    timer.timeit(_REPEATS // 10)
    return [1e3 * seconds for seconds in timer.repeat(_REPEATS, number=1)]


def _warm_up() -> None:
    """Export a small network: much is imported or read only then."""
    network = nn.Sequential(nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4), nn.ReLU(), nn.AdaptiveMaxPool2d(4))
    network.extend([nn.Flatten(), nn.Linear(64, 2)])
    kind = {"kind": Kind.classification.value}
    whole = _Whole([network], {"contract": kind, "mean": [0.0] * 3, "deviation": [1.0] * 3, "scale": [], "offset": []})
    switch(whole, training=False)
    contract: Any = type("Small", (), {"in_channels": 3, "image_size": 8})
    _write(whole, contract)


_warm_up()
