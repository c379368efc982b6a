"""Backward passes of adaptive pooling that a GPU repeats bit for bit (child side).

Those of CUDA use atomic additions, in whatever order the threads arrive. All baselines and nearly all candidates have
such a pooling, so without these no training on a GPU could promise its bits. Forward passes stay torch's.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray


@contextmanager
def repeating_pooling(device: torch.device) -> Iterator[None]:
    """Have torch compute these backward passes here, in this process, on devices of this one's type."""
    library: Any = torch.library.Library("aten", "IMPL")  # type: ignore[no-untyped-call]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that torch's own are not used is what is wanted
        library.impl("_adaptive_avg_pool2d_backward", _of_mean, device.type.upper())
        library.impl("adaptive_max_pool2d_backward", _of_maximum, device.type.upper())
    try:
        yield
    finally:
        del library  # they are in force as long as it lives


def _of_mean(gradient: torch.Tensor, images: torch.Tensor) -> torch.Tensor:
    """Return the gradient of images, shape (..., H, W), from that of the means of their windows, (..., h, w)."""
    total = _widened(gradient)
    for axis in (-2, -1):
        total = _shared_out(total, axis, images.shape[axis])
    return total.to(gradient.dtype)


def _shared_out(gradient: torch.Tensor, axis: int, size: int) -> torch.Tensor:
    """Give each of `size` positions the sum of its windows' gradients, each divided by the window's length.

    Window i of n holds the positions floor(i size / n) to ceil((i + 1) size / n) - 1, so position p lies in the windows
    floor(p n / size) to ceil((p + 1) n / size) - 1: one or two where there are no more windows than positions.
    """
    shape = [-1] + [1] * (-1 - axis)
    lengths, windows = _windows(gradient.shape[axis], size, gradient.device)
    each = gradient / lengths.reshape(shape)
    first, *others = windows
    total = each.index_select(axis, first[0])
    for window, is_held in others:
        total = total + torch.where(is_held.reshape(shape), each.index_select(axis, window), 0)
    return total


@lru_cache(maxsize=64)
def _windows(
    count: int, size: int, device: torch.device
) -> tuple[torch.Tensor, tuple[tuple[torch.Tensor, torch.Tensor], ...]]:
    """Return the lengths of an axis's windows; and each position's first window, its second, ..., if it has it."""
    number, position = np.arange(count), np.arange(size)
    lengths = -(-(number + 1) * size // count) - number * size // count
    first, last = position * count // size, -(-(position + 1) * count // size) - 1
    each = [first + step for step in range(int((last - first).max()) + 1)]

    def there(values: NDArray[Any]) -> torch.Tensor:
        return torch.from_numpy(values).to(device)

    return there(lengths), tuple((there(np.minimum(window, last)), there(window <= last)) for window in each)


def _of_maximum(gradient: torch.Tensor, images: torch.Tensor, chosen: torch.Tensor) -> torch.Tensor:
    """Return the gradient of images, shape (..., H, W), from that of the maxima, (..., h, w), and their positions.

    A position is the greatest of several windows where these overlap. `index_put_` adds in the order of the windows.
    """
    height, width = images.shape[-2:]
    planes = images.numel() // (height * width)
    start = torch.arange(planes, device=chosen.device)[:, None] * (height * width)
    positions = start.expand(planes, chosen.shape[-2] * chosen.shape[-1]).reshape(-1) + chosen.reshape(-1)
    added = _widened(gradient).reshape(-1)
    total = added.new_zeros(images.numel())
    total.index_put_((positions,), added, accumulate=True)
    return total.reshape(images.shape).to(gradient.dtype)


def _widened(gradient: torch.Tensor) -> torch.Tensor:
    """Return it in float32 at least, in which sums are taken."""
    return gradient.to(torch.promote_types(gradient.dtype, torch.float32))
