"""Elementary functions of the simulator: accurate enough for a picture, and equal to the last bit on every CPU."""

import hashlib
import importlib
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tacevo.data.simulator import portable
from tacevo.randomness import stream

#: Of every function at the points that `everything` looks at; other bits would be another simulator.
DIGEST = "fff2f51d5c34cc4dbff30c8cf01c842cf48308c34163a1e83ee2da49ade3f5f1"

#: Switches off what NumPy has beyond its baseline, so that its plainest loops run.
PLAINEST = {"NPY_DISABLE_CPU_FEATURES": "AVX512_SPR AVX512_ICL AVX512_SKX X86_V4 X86_V3 AVX2 FMA3"}


def require_plainest() -> None:
    """Fail where NumPy would still take its wide loops, because it calls the groups by other names now, say."""
    features = importlib.import_module("numpy._core._multiarray_umath").__cpu_features__
    assert not any(features.get(group) for group in ("X86_V3", "X86_V4", "AVX512_SKX", "AVX512_ICL")), features


def everything() -> bytes:
    """The bytes of every function in both precisions, and of the random draws."""
    parts = []
    for dtype in (np.float64, np.float32):
        x: portable.Field = np.linspace(-9, 9, 20_001).astype(dtype)
        above = np.abs(x)
        parts += [portable.exp_minus(above), portable.step(x), portable.sine(x), portable.cosine(x)]
        parts.append(portable.arctan(above))
    rng = stream(0, "test")
    parts += [portable.normal(rng, 0.3, (5, 7)), portable.grain(rng, 64)]
    return b"".join(part.tobytes() for part in parts)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize(
    ("function", "exact", "low", "high"),
    [
        (portable.exp_minus, lambda x: np.exp(-x), 0, 40),
        (portable.step, lambda x: 1 / (1 + np.exp(-x)), -40, 40),
        (portable.sine, lambda x: np.sin(2 * np.pi * x), -3, 3),
        (portable.cosine, lambda x: np.cos(2 * np.pi * x), -3, 3),
        (portable.arctan, np.arctan, 0, 50),
    ],
)
def test_functions_are_accurate_and_keep_the_type(
    function: Callable[[Any], Any],
    exact: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]],
    low: float,
    high: float,
    dtype: type,
) -> None:
    """The error is far below what a pixel of 255 grey values can show."""
    x: portable.Field = np.linspace(low, high, 100_001).astype(dtype)
    values = function(x)
    assert values.dtype == dtype
    assert np.abs(values - exact(x.astype(np.float64))).max() < (1e-6 if dtype is np.float64 else 2e-5)


def test_numbers_are_taken_like_arrays() -> None:
    """A number gives what an array of it gives, to the last bit."""
    for function in (portable.exp_minus, portable.step, portable.sine, portable.cosine, portable.arctan):
        assert function(0.3) == function(np.array([0.3]))[0]


def test_normal_numbers_have_the_moments_that_were_asked_for() -> None:
    """Mean, deviation and shape; 100,000 draws leave 1 % of room."""
    drawn = portable.normal(stream(0, "test"), 2.0, (1_000, 100))
    assert drawn.shape == (1_000, 100)
    assert abs(drawn.mean()) < 0.02
    assert drawn.std() == pytest.approx(2.0, rel=0.01)
    assert np.abs(drawn).max() <= 12


def test_grain_has_mean_zero_and_deviation_one() -> None:
    """And neighbouring pixels know nothing of each other."""
    drawn = portable.grain(stream(0, "test"), 256)
    assert drawn.dtype == np.float32
    assert abs(drawn.mean()) < 0.02
    assert drawn.std() == pytest.approx(1.0, rel=0.01)
    assert abs((drawn[:, 1:] * drawn[:, :-1]).mean()) < 0.02


def test_bits_are_those_of_every_machine() -> None:
    """The digest stands in this file, so another CPU or NumPy that gave other bits would show."""
    assert hashlib.sha256(everything()).hexdigest() == DIGEST


def test_plainest_loops_of_numpy_give_the_same_bits() -> None:
    """Without AVX, NumPy takes other machine code for every operation here."""
    script = (
        "import hashlib, test_data_portable as t; t.require_plainest(); "
        "print(hashlib.sha256(t.everything()).hexdigest())"
    )
    environment = {**os.environ, **PLAINEST, "PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script], env=environment, capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == DIGEST
