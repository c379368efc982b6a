"""A GPU made ready for one training (child side), before its process is confined and the candidate's code runs.

What fails here is not a candidate's doing: another GPU than the run's, a device that others have filled, a driver that
fails. It stops the search as a broken sandbox, and nothing is stored. What fails afterwards is the candidate's.
"""

import os
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from tacevo.choices import Precision
from tacevo.errors import SandboxError
from tacevo.records import Gpu, Recipe
from tacevo.sandbox.child import Arrays
from tacevo.sandbox.protocol import Header
from tacevo.training.captured import capture

#: Memory that a process takes of a GPU beside its tensors, for context and kernels, in MiB: 767 on an H200, with
#: torch 2.11.
CONTEXT_MIB = 1024
#: Rows that are copied to the device at once.
_BLOCK = 256


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
        header: of `tacevo.training.trainer.run`, with `lease`: the GPU as CUDA_VISIBLE_DEVICES names it (`visible`),
            and how many candidates may share it (`per_gpu`).
        payload: of the same.
        arrays: `images`, uint8 of shape (N, C, S, S).
        cuda: `torch.cuda`, or what stands for it in a test.
        device: where the images go.

    Returns:
        `images`, a `Resident`; and `capture`, where steps are to be recorded.

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
    _check_device(recipe.gpu, cuda, lease["per_gpu"])
    _limit_memory(recipe.gpu, cuda)
    multiply_in(recipe.gpu.precision)
    rows = np.frombuffer(payload, np.int64, header["train"] + header["validation"])
    images = Resident(arrays["images"], rows, torch.device(device))
    return {**arrays, "images": images, **({"capture": capture} if recipe.gpu.captured else {})}


def multiply_in(precision: Precision) -> None:
    """Let matrix products and convolutions of float32 use TF32, or not; torch itself lets convolutions."""
    torch.backends.cuda.matmul.allow_tf32 = precision is Precision.tf32
    torch.backends.cudnn.allow_tf32 = precision is Precision.tf32


def _check_device(gpu: Gpu, cuda: Any, per_gpu: int) -> None:
    model = cuda.get_device_name(0)
    if model != gpu.model:
        raise SandboxError(model, expected=gpu.model, remedy="use GPUs of one model, and set training.gpu to it")
    free, total = (size // 2**20 for size in cuda.mem_get_info(0))
    needed = per_gpu * (gpu.memory_mib + CONTEXT_MIB)
    remedy = "lower training.gpu_memory_mib or executor.per_gpu"
    if needed > total:
        raise SandboxError(f"{total} MiB", expected=f"a GPU with {needed} MiB for {per_gpu} candidates", remedy=remedy)
    if gpu.memory_mib > free:
        expected, remedy = f"{gpu.memory_mib} MiB free on the GPU", f"end what else uses it, or {remedy}"
        raise SandboxError(f"{free} MiB", expected=expected, remedy=remedy)


def _limit_memory(gpu: Gpu, cuda: Any) -> None:
    """Have torch refuse this process more memory than the recipe's; the refusal is an `OutOfMemoryError`."""
    total = cuda.get_device_properties(0).total_memory
    cuda.set_per_process_memory_fraction(min(1.0, gpu.memory_mib * 2**20 / total), 0)
