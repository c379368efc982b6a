"""A GPU made ready for one training (child side), before its process is confined and the candidate's code runs.

What fails here is not a candidate's doing: another GPU than the run's, a device that others have filled, a driver that
fails. It stops the search as a broken sandbox, and nothing is stored. What fails afterwards is the candidate's.
"""

import os
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from tacevo.choices import Precision
from tacevo.errors import SandboxError
from tacevo.records import Contract, Kind, Loss, Recipe, to_json, written
from tacevo.sandbox.child import Arrays, Send
from tacevo.sandbox.protocol import Header
from tacevo.training.captured import capture
from tacevo.training.cuda_libraries import map_libraries
from tacevo.training.memory import CONTEXT_MIB
from tacevo.training.trainer import run

#: Rows that are copied to the device at once.
_BLOCK = 256

#: The network that is trained when a GPU is looked at, on so few images: the parts that most candidates have.
_SMALL = """
class Small(nn.Module):
    def __init__(self):
        super().__init__()
        seen = [nn.Conv2d(3, 8, 3), nn.BatchNorm2d(8), nn.ReLU(), nn.MaxPool2d(2), nn.AdaptiveAvgPool2d(4)]
        self.body = nn.Sequential(*seen, nn.Flatten(), nn.Dropout(0.1), nn.Linear(128, 3))

    def forward(self, x):
        return self.body(x)
"""
_CONTRACT = Contract(
    class_name="Small",
    kind=Kind.regression,
    loss=Loss.mse,
    in_channels=3,
    image_size=32,
    outputs=3,
    output_argument="outputs",
)
_FEW, _BATCH = 12, 4

map_libraries()  # once, in the process that imports this for all its forks


class Resident:
    """Images on a device, uint8, each of them once; `resident[rows]` are those of some rows of the data set."""

    def __init__(self, images: NDArray[np.uint8], rows: NDArray[np.int64], device: torch.device) -> None:
        self._rows, self._device = np.unique(rows), device
        self._images = torch.empty((len(self._rows), *images.shape[1:]), dtype=torch.uint8, device=device)
        for start in range(0, len(self._rows), _BLOCK):  # so that the host never holds a second copy of them all
            block = self._rows[start : start + _BLOCK]
            self._images[start : start + _BLOCK] = torch.from_numpy(images[block])

    def __getitem__(self, rows: NDArray[np.int64]) -> torch.Tensor:
        """Return images, uint8 on the device, shape (len(rows), C, S, S)."""
        return self.take(self.places(rows))

    def places(self, rows: NDArray[np.int64]) -> torch.Tensor:
        """Return where images lie, int64 on the device, shape (len(rows),)."""
        return torch.from_numpy(np.searchsorted(self._rows, rows)).to(self._device)

    def take(self, places: torch.Tensor) -> torch.Tensor:
        """Return the images at these places; nothing waits for the processor."""
        return self._images.index_select(0, places)


def equip(header: Header, payload: bytes, arrays: Arrays, *, cuda: Any = torch.cuda, device: str = "cuda") -> Arrays:
    """Take the GPU that a training was lent, and put its images there; a job without a GPU keeps its arrays.

    Args:
        header: of `tacevo.training.trainer.run`, or of `look`, with `lease`: the GPU as CUDA_VISIBLE_DEVICES names it
            (`visible`), and how many candidates may share it (`per_gpu`), or how much memory this one may have (`mib`).
        payload: of the same.
        arrays: `images`, uint8 of shape (N, C, S, S).
        cuda: `torch.cuda`, or what stands for it in a test.
        device: where the images go.

    Returns:
        `images`, a `Resident`; `capture`, where steps are to be recorded; `refused`, where it has less memory than its
        recipe allows: what says how often it was refused some; and for `look` black images, and what was free as
        `free_mib`.

    Raises:
        SandboxError: it is not the GPU of the recipe, or its memory does not suffice for all who share it.
        RuntimeError: the driver failed.
    """
    if "lease" not in header:
        return arrays
    recipe, lease = Recipe.from_json(header["recipe"]), header["lease"]
    if recipe.gpu is None:
        raise SandboxError("a recipe for a CPU", expected="the GPU that the training is to have")
    os.environ["CUDA_VISIBLE_DEVICES"] = lease["visible"]  # read when the driver starts, which is in the next call
    mib = lease.get("mib", recipe.gpu.memory_mib)
    free = _check_device(recipe.gpu.model, cuda, mib, lease.get("per_gpu", 1))
    _limit_memory(mib, cuda)
    multiply_in(recipe.gpu.precision)
    more: dict[str, Any] = {"capture": capture} if recipe.gpu.captured else {}
    if "train" not in header:
        black = np.zeros((_FEW, _CONTRACT.in_channels, _CONTRACT.image_size, _CONTRACT.image_size), np.uint8)
        images = Resident(black, np.arange(_FEW), torch.device(device))
        return {**arrays, **more, "images": images, "free_mib": free}
    if mib < recipe.gpu.memory_mib:
        more["refused"] = lambda: cuda.memory_stats(0)["num_ooms"]
    rows = np.frombuffer(payload, np.int64, header["train"] + header["validation"])
    return {**arrays, **more, "images": Resident(arrays["images"], rows, torch.device(device))}


def look(header: Header, payload: bytes, arrays: Arrays, send: Send, *, device: str = "cuda") -> object:
    """Train a small network on a GPU, confined as candidates are; send what was free before, `{"free_mib"}`.

    Or send `{"failed"}`, why it does not train. Where the header says `walled`, and the recipe asks for recorded steps,
    it must be able to record them: walls must not decide how candidates train. None of their code runs in this process.
    """
    rows, targets = np.arange(_FEW), np.zeros((_FEW - _BATCH, _CONTRACT.outputs), np.float32)
    job = {
        "source": _SMALL,
        "contract": to_json(_CONTRACT),
        "recipe": written(replace(Recipe.from_json(header["recipe"]), epochs=1, batch_size=_BATCH)),
        "seed": 0,
        "mean": [127.5] * _CONTRACT.in_channels,
        "deviation": [74.0] * _CONTRACT.in_channels,
        "train": len(targets),
        "validation": _BATCH,
        "device": device,
    }
    frames: list[Any] = []
    data = rows.tobytes() + targets.tobytes()
    kept = run(job, data, arrays, lambda head, _: frames.append(head))
    end = frames[-1]
    if "rejection" in end:
        send({"failed": f"{end['rejection']['reason']}: {end['rejection']['detail']}"}, b"")
    elif header["walled"] and end.get("captured") is False:
        send({"failed": "a step that cannot be recorded behind walls; training.captured=false asks for none"}, b"")
    else:
        send({"free_mib": arrays["free_mib"]}, b"")
    return kept


def multiply_in(precision: Precision) -> None:
    """Let matrix products and convolutions of float32 use TF32, or not; torch itself lets convolutions."""
    torch.backends.cuda.matmul.allow_tf32 = precision is Precision.tf32
    torch.backends.cudnn.allow_tf32 = precision is Precision.tf32


def _check_device(expected_model: str, cuda: Any, mib: int, per_gpu: int) -> int:
    """Check the GPU, of which so many processes take so much memory each; return what is free of it, in MiB."""
    model = cuda.get_device_name(0)
    if model != expected_model:
        raise SandboxError(model, expected=expected_model, remedy="use GPUs of one model, and set training.gpu to it")
    free, total = (size // 2**20 for size in cuda.mem_get_info(0))
    needed = per_gpu * (mib + CONTEXT_MIB)
    remedy = "lower training.gpu_memory_mib or executor.per_gpu"
    if needed > total:
        raise SandboxError(f"{total} MiB", expected=f"a GPU with {needed} MiB for {per_gpu} candidates", remedy=remedy)
    if mib > free:
        expected, remedy = f"{mib} MiB free on the GPU", f"end what else uses it, or {remedy}"
        raise SandboxError(f"{free} MiB", expected=expected, remedy=remedy)
    return int(free)


def _limit_memory(mib: int, cuda: Any) -> None:
    """Have torch refuse this process more memory; the refusal is an `OutOfMemoryError`."""
    total = cuda.get_device_properties(0).total_memory
    cuda.set_per_process_memory_fraction(min(1.0, mib * 2**20 / total), 0)
