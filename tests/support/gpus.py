"""Tests that need a GPU, which `make test-gpu` runs where there is one."""

from collections.abc import Callable
from typing import Any

import pytest
import torch


def needs_gpu(test: Callable[..., Any]) -> Callable[..., Any]:
    """Mark a test, and skip it where torch can use no CUDA device."""
    skipped = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
    marked: Callable[..., Any] = pytest.mark.gpu(skipped(test))
    return marked
