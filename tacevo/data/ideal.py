"""The best that can be done on simulated gratings; studies are read by it where the simulator is not installed."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from tacevo.rounding import rounded

#: The standard deviation of the share by which printing and the stretched skin alter the width of a ridge: the error
#: that no network can undo.
WIDTH_ERROR = 0.03


def ideal_accuracy(spacings_mm: Sequence[float]) -> float:
    """Return the accuracy that no network can expect to exceed on gratings of these spacings, in (0, 1].

    The class enters a picture by the width of the ridges alone, and that errs. So it is that of an observer who sees
    every width, and names the likeliest of classes that are equally frequent: the integral of their largest density.
    """
    means = np.array(sorted(spacings_mm))[:, None]
    logs = np.arange(math.log(0.6 * means[0, 0]), math.log(1.4 * means[-1, 0]), WIDTH_ERROR / 200)
    widths = np.exp(logs)
    densities = normal_density((widths / means - 1) / WIDTH_ERROR) / (WIDTH_ERROR * means)
    return rounded(float(np.trapezoid(densities.max(axis=0) * widths, logs)) / len(means))


def normal_density(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the density of what `normal` draws with a deviation of 1 (Irwin and Hall's, of twelve)."""
    inwards = 6 - np.abs(values)
    parts = [(-1) ** step * math.comb(12, step) * np.maximum(inwards - step, 0.0) ** 11 for step in range(7)]
    return np.asarray(np.sum(parts, axis=0) / math.factorial(11))
