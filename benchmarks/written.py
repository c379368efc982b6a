"""How the tables of these benchmarks write a figure."""

import math
from collections.abc import Sequence

from analysis.statistics.effects import mean_with_interval


def interval(estimate: float, low: float, high: float, digits: int = 2) -> str:
    """Write an estimate with the ends of its interval."""
    return f"{estimate:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def geometric_mean(logarithms: Sequence[float], digits: int = 2) -> str:
    """Write the geometric mean of n >= 2 values, of their logarithms, with its 95 % interval (Student's)."""
    mean, low, high = map(math.exp, mean_with_interval(logarithms))
    return interval(mean, low, high, digits)
