"""Computes the expressions, forward and backward, in a process that has the variables of portable numerics.

It imports no SciPy and does not fork: either makes qemu 7.2 crash in oneDNN's LSTM.
"""

import hashlib
import math
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from tacevo.gate.kernels import KernelWatcher
from tacevo.randomness import stream
from tacevo.sandbox.functions import portable_functions

#: Shape of an element-wise operand.
_MANY = (20, 1000)


def not_portable(expression: str) -> tuple[str, ...]:
    """Return the kernels of an expression whose bits may depend on the CPU, as the probe would flag them."""
    with KernelWatcher() as watcher:
        computed(expression)
    return tuple(sorted(watcher.not_portable))


def computed(expression: str) -> str:
    """Compute an expression, and the gradients of what it began with; return the digest of all of it.

    Returns:
        64 hex digits, or `refused` where torch has no deterministic form of it.
    """
    torch.manual_seed(0)
    inputs = operands()
    names = {"torch": torch, "nn": nn, "F": nn.functional, "math": math, **inputs}
    try:
        with portable_functions():
            outputs = list(_tensors(eval(expression, names)))
            gradients = _gradients([output for output in outputs if output.requires_grad])
    except RuntimeError as error:
        if "deterministic" not in str(error):
            raise
        return "refused"
    return digest([_bits(tensor) for tensor in [*outputs, *gradients]])


def digest(parts: Sequence[bytes]) -> str:
    """Hash bytes: 64 hex digits of SHA-256."""
    return hashlib.sha256(b"".join(parts)).hexdigest()


def operands() -> dict[str, Tensor]:
    """Return what the expressions name; those of float32 want gradients."""
    tensors = {name: torch.from_numpy(values.copy()) for name, values in _operands().items()}
    return {name: tensor.requires_grad_(tensor.is_floating_point()) for name, tensor in tensors.items()}


@cache
def _operands() -> dict[str, NDArray[Any]]:
    """Make the values, from whole numbers and correctly rounded operations alone."""
    draws = stream(0, "operands")
    even = np.arange(-150_000, 150_001) / 150_000

    def between(low: float, high: float, *shape: int) -> NDArray[np.float32]:
        return (low + (high - low) * draws.random(shape)).astype(np.float32)

    m = between(-0.5, 0.5, 5, 16, 16)
    return {
        **{"X": (8 * even).astype(np.float32), "L": even.astype(np.float32)},
        "P": (25.0005 + 24.9995 * even).astype(np.float32),
        **{"x": between(-6, 6, *_MANY), "y": between(-6, 6, *_MANY)},
        **{"p": between(1e-3, 6, *_MANY), "u": between(-0.999, 0.999, *_MANY)},
        "k": draws.integers(0, 100, _MANY),
        "w": between(-1, 1, 100),
        "i": between(-2, 2, 4, 8, 12, 12),
        "s": between(-2, 2, 4, 12, 8),
        "d": between(-2, 2, 2, 4, 6, 8, 8),
        "g": between(-1, 1, 4, 9, 9, 2),
        "m": m,
        # Symmetric and, by its diagonal, positive definite.
        "h": (m + m.transpose(0, 2, 1)) / 2 + 16 * np.eye(16, dtype=np.float32),
    }


def _gradients(outputs: Sequence[Tensor]) -> list[Tensor]:
    """Send fixed gradients back from the outputs; give those that arrive at the operands and the layers' weights."""
    draws = stream(0, "gradients")
    leaves = list(_leaves(outputs))
    seeds = [torch.from_numpy(draws.random(tuple(output.shape))).to(output.dtype) for output in outputs]
    if outputs:
        torch.autograd.backward(outputs, seeds)
    return [leaf.grad for leaf in leaves if leaf.grad is not None]


def _leaves(outputs: Sequence[Tensor]) -> Iterator[Tensor]:
    """Find the tensors that the outputs were computed from, in the order in which the graph names them."""
    waiting: list[Any] = [output.grad_fn for output in outputs]
    seen: set[int] = set()
    alive = []
    while waiting:
        node = waiting.pop(0)
        if node is None or id(node) in seen:
            continue
        seen.add(id(node))
        alive.append(node)  # keeps its id from being given to another node
        if hasattr(node, "variable"):
            yield node.variable
        waiting += [following for following, _ in node.next_functions]


def _tensors(value: Any) -> Iterator[Tensor]:
    """Walk the tensors of a result, which may be nested."""
    if isinstance(value, Tensor):
        yield value
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _tensors(item)
    elif value is not None:
        yield torch.tensor(value)


def _bits(tensor: Tensor) -> bytes:
    """Return a tensor's bytes; every NaN alike, since which one it is follows no rule."""
    plain = tensor.detach().clone().resolve_conj()
    if plain.is_complex():
        plain = torch.view_as_real(plain)
    if plain.dtype is torch.bfloat16:  # NumPy has none; float32 holds its numbers exactly
        plain = plain.float()
    values: NDArray[Any] = plain.numpy()
    if values.dtype.kind == "f":
        values[np.isnan(values)] = np.nan
    return values.tobytes()
