"""Promise: the backward passes of adaptive pooling that stand in for CUDA's are those of the same function.

They are put in place of the CPU's here, and compared with them; that a GPU repeats them is shown on a GPU
(tests/training/test_determinism.py).
"""

from collections.abc import Callable

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.nn import functional

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


@pytest.mark.parametrize("pool", POOLINGS)
@given(shape=st.lists(LENGTHS, min_size=3, max_size=4), size=st.tuples(LENGTHS, LENGTHS))
def test_gradients_are_torchs_own(pool: Callable[..., torch.Tensor], shape: list[int], size: tuple[int, int]) -> None:
    """Of more windows than places too, of one image and of many."""
    images = torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    expected = gradient(pool, images, size)
    with repeating_pooling(CPU):
        found = gradient(pool, images, size)
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("pool", POOLINGS)
def test_bfloat16_is_summed_in_float32(pool: Callable[..., torch.Tensor]) -> None:
    """The gradient has the type of the images, and is no further from the exact one than its rounding."""
    images = torch.rand(2, 3, 9, 9, generator=torch.Generator().manual_seed(0)).to(torch.bfloat16)
    exact = gradient(pool, images.double(), (4, 4))
    with repeating_pooling(CPU):
        found = gradient(pool, images, (4, 4))
    assert found.dtype is torch.bfloat16
    torch.testing.assert_close(found.double(), exact, rtol=2**-7, atol=2**-8)


def test_pooling_of_one_axis_is_replaced_with_it() -> None:
    """Torch computes it by that of two."""
    images = torch.rand(2, 3, 7, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    expected = gradient(functional.adaptive_avg_pool1d, images, (3,))
    with repeating_pooling(CPU):
        torch.testing.assert_close(gradient(functional.adaptive_avg_pool1d, images, (3,)), expected)


def test_torchs_own_are_back_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    """After an error, too."""

    def wrong(_: torch.Tensor, images: torch.Tensor) -> torch.Tensor:
        return torch.full_like(images, 7.0)

    monkeypatch.setattr("tacevo.training.pooling._of_mean", wrong)
    images = torch.rand(1, 1, 4, 4)

    def replaced() -> torch.Tensor:
        with repeating_pooling(CPU):
            found.append(gradient(functional.adaptive_avg_pool2d, images, (2, 2)))
            raise KeyError

    found: list[torch.Tensor] = []
    with pytest.raises(KeyError) as raised:
        replaced()
    assert raised.tb  # which keeps alive what was there
    found.append(gradient(functional.adaptive_avg_pool2d, images, (2, 2)))
    assert [bool((each == 7.0).all()) for each in found] == [True, False]
