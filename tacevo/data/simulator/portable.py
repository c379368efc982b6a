"""Elementary functions and random numbers with the same bits on every CPU.

The exponential, sine and arctangent of a mathematics library differ in their last bits between CPUs, and now and
then such a bit moves a pixel across a rounding boundary. Here everything is made of additions, multiplications,
divisions and square roots, which IEEE 754 rounds correctly everywhere, and of whole numbers. Accuracy is that of a
picture: absolute errors stay below 1e-6 in float64 and 2e-5 in float32, which is kept where an argument has it.
"""

import math

import numpy as np
import numpy.typing as npt

#: An array of float32 or float64; a result has the shape and type of the argument, and none for a plain number.
Field = npt.NDArray[np.floating]

Real = float | Field


def exp_minus(x: Real) -> Field:
    """Find exp(-x) for x >= 0: a Taylor series at x / 256, squared eight times; below exp(-16) it is about 0."""
    y = np.minimum(x, 16.0) * (1 / 256)
    power: Field = 1 - y * (1 - y * (1 / 2) * (1 - y * (1 / 3) * (1 - y * (1 / 4))))
    for _ in range(8):
        power = power * power
    return power


def step(x: Real) -> Field:
    """Find the logistic step 1 / (1 + exp(-x)): 0 far below 0, 1/2 at 0, 1 far above."""
    small = exp_minus(np.abs(x))
    return np.where(x > 0, 1.0, small) / (1 + small)


def sine(turns: Real) -> Field:
    """Find sin(2 pi turns), for an angle in whole turns of any size."""
    part = turns - np.rint(turns)
    folded = np.where(np.abs(part) > 0.25, np.copysign(0.5, part) - part, part)
    angle = 2 * math.pi * folded
    square = angle * angle
    series: Field = 1 - square * (1 / 72) * (1 - square * (1 / 110))
    for product in (42, 20, 6):  # sin x = x (1 - x^2/6 (1 - x^2/20 (1 - ...)))
        series = 1 - square * (1 / product) * series
    return angle * series


def cosine(turns: Real) -> Field:
    """Find cos(2 pi turns), for an angle in whole turns of any size."""
    return sine(turns + 0.25)


def arctan(x: Real) -> Field:
    """Find the arctangent of x >= 0, in radians: three halvings of the angle, then a Taylor series."""
    part: Field = np.asarray(x)
    for _ in range(3):
        part = part / (1 + np.sqrt(1 + part * part))
    square = part * part
    series = 1 / 9 - square * (1 / 11)
    for odd in (7, 5, 3, 1):
        series = 1 / odd - square * series
    return 8 * part * series


def normal(rng: np.random.Generator, deviation: float, shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
    """Draw nearly normal numbers of mean 0: sums of twelve uniform ones, hence within six deviations."""
    total: npt.NDArray[np.int64] = rng.integers(0, 2**32, (*shape, 12)).sum(axis=-1)
    return np.asarray(deviation * (total / 2**32 - 6))


def normal_number(rng: np.random.Generator, mean: float, deviation: float) -> float:
    """Draw one nearly normal number."""
    return mean + float(normal(rng, deviation, ()))


def grain(rng: np.random.Generator, size: int) -> npt.NDArray[np.float32]:
    """Draw the grain of one picture: each pixel the sum of four random bytes, at mean 0 and deviation 1.

    Nearly normal (excess kurtosis -0.3), and quicker than normal numbers.
    """
    words = rng.integers(0, 2**32, (size, size), dtype=np.uint32)
    pairs = (words & 0x00FF00FF) + (words >> 8 & 0x00FF00FF)  # two sums of two bytes in each word
    total = (pairs & 0xFFFF) + (pairs >> 16)
    return (total.astype(np.float32) - 510) * (1 / math.sqrt((256**2 - 1) / 3))
