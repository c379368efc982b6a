"""Promise: the backward passes of adaptive pooling that stand in for CUDA's are those of the same function.

They are put in place of the CPU's here, and compared with them; that a GPU repeats them is shown on a GPU
(tests/training/test_determinism.py).
"""

from collections.abc import Callable
from unittest import mock

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.nn import functional

from tacevo.training import pooling
from tacevo.training.pooling import repeating_pooling

CPU = torch.device("cpu")
POOLINGS = (functional.adaptive_avg_pool2d, functional.adaptive_max_pool2d)
LENGTHS = st.integers(1, 9)


def gradient(pool: Callable[..., torch.Tensor], images: torch.Tensor, size: tuple[int, ...]) -> torch.Tensor:
    """Return that of the images, for an uneven gradient of what is pooled."""
    pooled = pool(images.requires_grad_(), size)
    uneven = torch.linspace(-1, 2, pooled.numel()).to(torch.bfloat16)  # whose values every type has
    (found,) = torch.autograd.grad(pooled, images, uneven.to(images.dtype).reshape(pooled.shape))
    return found


def drawn(*shape: int, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    """Draw images, the same each time."""
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).to(dtype)


@pytest.mark.parametrize("pool", POOLINGS)
@given(number=st.integers(0, 3), shape=st.tuples(LENGTHS, LENGTHS, LENGTHS), size=st.tuples(LENGTHS, LENGTHS))
def test_gradients_are_torchs_own(
    pool: Callable[..., torch.Tensor], number: int, shape: tuple[int, int, int], size: tuple[int, int]
) -> None:
    """Of more windows than places too, and of no image, one and several."""
    for images in (drawn(number, *shape), drawn(*shape)):
        expected = gradient(pool, images, size)
        with repeating_pooling(CPU):
            found = gradient(pool, images, size)
        torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("pool", POOLINGS)
def test_bfloat16_is_summed_in_float32(pool: Callable[..., torch.Tensor]) -> None:
    """The gradient, here a sum of many, is that of float32, rounded once."""
    images = drawn(2, 3, 5, 5, dtype=torch.bfloat16)
    with repeating_pooling(CPU):
        found, exact = gradient(pool, images, (32, 32)), gradient(pool, images.detach().float(), (32, 32))
    assert found.dtype is torch.bfloat16
    assert torch.equal(found, exact.to(torch.bfloat16))


def test_infinite_gradient_stays_with_its_window() -> None:
    """As with torch's own."""
    images = drawn(1, 1, 5, 5).requires_grad_()
    with repeating_pooling(CPU):
        pooled = functional.adaptive_avg_pool2d(images, 2)
        (found,) = torch.autograd.grad(pooled, images, torch.tensor([[[[torch.inf, 1.0], [1.0, 1.0]]]]).double())
    assert found.isinf().sum() == 9
    assert not found.isnan().any()


@pytest.mark.parametrize(
    ("replaced", "pool", "size"),
    [
        ("_of_mean", functional.adaptive_avg_pool2d, (2, 2)),
        ("_of_mean", functional.adaptive_avg_pool1d, (2,)),
        ("_of_maximum", functional.adaptive_max_pool2d, (2, 2)),
        ("_of_maximum", functional.adaptive_max_pool1d, (2,)),
    ],
)
def test_torchs_own_are_replaced_and_back_afterwards(
    replaced: str, pool: Callable[..., torch.Tensor], size: tuple[int, ...]
) -> None:
    """Those of one axis too, which torch computes by those of two; and after an error, too."""
    images, found = drawn(1, 4, 4), []

    def wrong(_: torch.Tensor, images: torch.Tensor, *__: torch.Tensor) -> torch.Tensor:
        return torch.full_like(images, 7.0)

    def failing() -> None:
        with mock.patch.object(pooling, replaced, wrong), repeating_pooling(CPU):
            found.append(gradient(pool, images, size))
            raise KeyError

    with pytest.raises(KeyError) as raised:
        failing()
    assert raised.tb  # which keeps alive what was there
    found.append(gradient(pool, images, size))
    assert [bool((each == 7.0).all()) for each in found] == [True, False]
