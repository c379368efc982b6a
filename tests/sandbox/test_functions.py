"""Promise: square roots, arcs and tangents are computed here, as torch would, and alike on every CPU."""

import itertools
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tacevo.sandbox.functions import PORTABLE, portable_functions

KINDS = (torch.float64, torch.float32, torch.float16, torch.bfloat16, torch.int64, torch.bool, torch.complex64)

#: Ways in which values lie in memory.
LAYOUTS: dict[str, Callable[[Tensor], Tensor]] = {
    "dense": lambda values: values,
    "channels_last": lambda values: values.reshape(4, 16, 8, 8).contiguous(memory_format=torch.channels_last),
    "strided": lambda values: values[::3],
    "transposed": lambda values: values.reshape(64, 64).T,
    "expanded": lambda values: values[:5, None].expand(5, 3),
    "one number": lambda values: values[0],
    "empty": lambda values: values[:0],
}

EXPONENTS = (0.5, 2, 2.0, 1.5, -0.5, 3.3, 0, 1, -1, True)


def values(kind: torch.dtype) -> Tensor:
    """Return 4,096 values, those of real numbers from -1 to 1."""
    drawn = torch.from_numpy(np.random.default_rng(0).uniform(-1, 1, 4096)).float()
    return torch.complex(drawn, drawn.flip(0)) if kind.is_complex else drawn.to(kind)


def outcome(function: Callable[[Tensor], Tensor], given: Tensor) -> Any:
    """Return what a call gives, with its form; or what it raises."""
    try:
        result = function(given)
    except RuntimeError as error:
        return type(error), str(error)
    return result, result.dtype, result.shape, result.stride()


def calls() -> list[tuple[str, Callable[[Tensor], Tensor]]]:
    """Return every function and power, also in place."""

    def power(exponent: float, name: str) -> Callable[[Tensor], Tensor]:
        return lambda tensor: getattr(tensor.clone(), name)(exponent)

    functions = [(name, getattr(torch, name)) for name in PORTABLE]
    in_place = [(f"{name}_", lambda tensor, name=name: getattr(tensor.clone(), f"{name}_")()) for name in PORTABLE]
    powers = [(f"{name} {exponent}", power(exponent, name)) for name in ("pow", "pow_") for exponent in EXPONENTS]
    return [*functions, *in_place, *powers]


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_results_have_torchs_own_form(kind: torch.dtype) -> None:
    """Types, shapes, strides, refusals and values up to rounding; other powers than 0.5 have torch's bits."""
    for (name, function), (layout, laid) in itertools.product(calls(), LAYOUTS.items()):
        given = laid(values(kind))
        own = outcome(function, given)
        with portable_functions():
            got = outcome(function, given)
        assert got[1:] == own[1:], (name, layout)
        if isinstance(own[0], Tensor):
            rounding = 0.0 if name.startswith("pow") and not name.endswith("0.5") else 4 * _step(own[1])
            torch.testing.assert_close(got[0], own[0], rtol=rounding, atol=0, equal_nan=True, msg=f"{name}, {layout}")


def _step(kind: torch.dtype) -> float:
    return torch.finfo(kind).eps if kind.is_floating_point or kind.is_complex else 0.0


@pytest.mark.parametrize("kind", [torch.float32, torch.float64], ids=str)
def test_square_roots_are_the_nearest_numbers(kind: torch.dtype) -> None:
    """IEEE 754 fixes them to the last bit; MKL's, which follow the CPU, are others, so this replaces something."""
    bits = np.random.default_rng(0).integers(0, 2**32 if kind is torch.float32 else 2**64, 1 << 12, dtype="u8")
    every = bits.astype("u4").view("f4") if kind is torch.float32 else bits.view("f8")
    numbers = torch.from_numpy(np.abs(every[np.isfinite(every)]))
    with portable_functions():
        roots = torch.sqrt(numbers)
        assert torch.equal(numbers**0.5, roots)
        assert torch.equal(numbers.clone().sqrt_(), roots)
    assert not torch.equal(torch.sqrt(numbers), roots)
    lower, upper = (np.nextafter(roots.numpy(), roots.new_tensor(end).numpy()) for end in (0, np.inf))
    for number, below, root, above in zip(*map(_exact, (numbers, lower, roots, upper)), strict=True):
        assert (below + root) ** 2 <= 4 * number <= (root + above) ** 2


def _exact(numbers: Any) -> list[Fraction]:
    return [Fraction(number) for number in numbers.tolist()]


def test_functions_can_be_learnt_through() -> None:
    """Their gradients are right, also of gradients, in place, and over a batch by vmap."""
    inputs = torch.linspace(0.05, 0.9, 12, dtype=torch.float64).requires_grad_()
    with portable_functions():
        for _, function in calls()[: 2 * len(PORTABLE)]:
            assert torch.autograd.gradcheck(lambda tensor, function=function: function(tensor * 1), inputs)
        for exponent in (0.5, 1.5, 2.5):
            assert torch.autograd.gradgradcheck(lambda tensor, exponent=exponent: tensor**exponent, inputs)
        rows = inputs.detach().reshape(3, 4)
        assert torch.equal(torch.func.vmap(torch.sqrt)(rows), torch.sqrt(rows))
        with torch.inference_mode():
            assert torch.equal(torch.sqrt(rows), rows**0.5)


def test_torchs_own_functions_come_back() -> None:
    """Afterwards each gives the bits that it gave before, also where something was raised within."""
    given = values(torch.float64).abs()
    before = [function(given) for _, function in calls()]
    with pytest.raises(ZeroDivisionError), portable_functions():
        _ = 1 / 0
    after = [function(given) for _, function in calls()]
    assert all(
        torch.equal(torch.nan_to_num(one), torch.nan_to_num(other)) for one, other in zip(before, after, strict=True)
    )
