"""Whether what was drawn came as often as it should."""

from scipy.stats import binomtest


def agrees(count: int, share: float, draws: int) -> bool:
    """Tell whether a count of so many draws agrees with a probability, by an exact binomial test."""
    return float(binomtest(count, draws, share).pvalue) > 1e-4
