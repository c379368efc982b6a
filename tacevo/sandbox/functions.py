"""Functions of numbers that every CPU computes alike (child side).

ATen takes these from MKL's vector library, whose code approximates by instructions that each maker of CPUs rounds in
its own way, under every setting. Here they are NumPy's square root, which IEEE 754 fixes to the last bit, and torch's
own `atan2`, `sin` and `cos` (docs/determinism.md).
"""

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from torch import Tensor

_Function = Callable[[Tensor], Tensor]


@contextmanager
def portable_functions() -> Iterator[None]:
    """Have torch compute the functions in `PORTABLE`, and powers of 0.5, here, in this process, on its CPU.

    What is complex or is written into `out=` stays torch's own.
    """
    library: Any = torch.library.Library("aten", "IMPL")  # type: ignore[no-untyped-call]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that torch's own are not used is what is wanted
        for name, function in PORTABLE.items():
            into = getattr(torch.ops.aten, name).out
            library.impl(name, _returned(function, into), "CPU")
            library.impl(f"{name}_", _in_place(function, into), "CPU")
        library.impl("pow.Tensor_Scalar", _power, "CPU")
        library.impl("pow_.Scalar", _power_in_place, "CPU")
    try:
        yield
    finally:
        del library  # they are in force as long as it lives


def _square_root(values: Tensor) -> Tensor:
    root = torch.empty_like(values)
    with np.errstate(invalid="ignore"):
        np.sqrt(values.detach().numpy(), out=root.numpy())
    return root


def _cathetus(values: Tensor) -> Tensor:
    """Return the square root of 1 - values^2; this form of it loses no digits near 1."""
    return _square_root((1 - values) * (1 + values))


def _tangent(values: Tensor) -> Tensor:
    wide = values.to(torch.float64)
    return (torch.sin(wide) / torch.cos(wide)).to(values.dtype)


#: The functions of one tensor, float32 or float64.
PORTABLE: Mapping[str, _Function] = {
    "sqrt": _square_root,
    "atan": lambda values: torch.atan2(values, torch.ones_like(values)),
    "acos": lambda values: torch.atan2(_cathetus(values), values),
    "asin": lambda values: torch.atan2(values, _cathetus(values)),
    "tan": _tangent,
}


def _returned(function: _Function, into: Any) -> _Function:
    """Make the form of a function that returns a new tensor."""

    def compute(values: Tensor) -> Tensor:
        if values.is_complex():
            own: Tensor = into(values, out=torch.empty_like(values))
            return own
        wide = values.to(torch.promote_types(_kind(values), torch.float32))
        return function(wide).to(_kind(values))

    return compute


def _in_place(function: _Function, into: Any) -> _Function:
    """Make the form of a function that changes its tensor; of whole numbers torch refuses it."""
    new = _returned(function, into)

    def change(values: Tensor) -> Tensor:
        return values.copy_(new(values)) if values.is_floating_point() else into(values, out=values)

    return change


def _kind(values: Tensor) -> torch.dtype:
    """Return the type of a function's results: whole numbers give torch's default."""
    return values.dtype if values.is_floating_point() else torch.get_default_dtype()


def _power(values: Tensor, exponent: Any) -> Tensor:
    if exponent == 0.5:
        return torch.sqrt(values)
    into = torch.empty(0, dtype=torch.result_type(values, exponent))
    return torch.ops.aten.pow.Tensor_Scalar_out(values, exponent, out=into)  # type: ignore[no-any-return]


def _power_in_place(values: Tensor, exponent: Any) -> Tensor:
    if exponent == 0.5:
        return torch.sqrt_(values)
    return torch.ops.aten.pow.Tensor_Scalar_out(values, exponent, out=values)  # type: ignore[no-any-return]
