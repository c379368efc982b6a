"""A GPU of 16 GiB that is the CPU, for whole trainings in a sandbox: only the driver's answers are made up.

A training that has less than `NEEDED_MIB` is told that it was refused memory, and goes on without, as cuDNN does.
"""

from types import SimpleNamespace
from typing import Any

from tacevo.sandbox.child import Arrays, Send
from tacevo.training import gpu, trainer

MODEL, NEEDED_MIB = "NVIDIA H200", 3000
_MIB, _TOTAL = 2**20, 16_384


class _Cuda:
    """What `torch.cuda` would say."""

    def __init__(self) -> None:
        self._allowed = 0.0

    def get_device_name(self, device: int) -> str:
        return MODEL

    def mem_get_info(self, device: int) -> tuple[int, int]:
        return (_TOTAL - 500) * _MIB, _TOTAL * _MIB

    def get_device_properties(self, device: int) -> SimpleNamespace:
        return SimpleNamespace(total_memory=_TOTAL * _MIB)

    def set_per_process_memory_fraction(self, fraction: float, device: int) -> None:
        self._allowed = fraction * _TOTAL

    def memory_stats(self, device: int) -> dict[str, int]:
        return {"num_ooms": int(self._allowed < NEEDED_MIB)}


def equip(header: Any, payload: bytes, arrays: Arrays) -> Arrays:
    """Take a GPU as `tacevo.training.gpu.equip` does."""
    return gpu.equip(header, payload, arrays, cuda=_Cuda(), device="cpu")


def train(header: Any, payload: bytes, arrays: Arrays, send: Send) -> object:
    """Train on the CPU."""
    return trainer.run({name: value for name, value in header.items() if name != "device"}, payload, arrays, send)


def look(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Look at the GPU, and compute on the CPU."""
    gpu.look(header, payload, arrays, send, device="cpu")
