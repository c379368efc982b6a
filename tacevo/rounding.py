"""How many digits of a computed number are kept.

Special functions and wide loops differ in their last bits between CPUs (docs/determinism.md), so
numbers are rounded before they enter a file or a table.
"""

#: Significant digits of losses, metrics and statistics.
DIGITS = 9


def rounded(value: float) -> float:
    """Keep 9 significant digits: more than any table shows, and none that depends on the CPU."""
    return float(f"{value:.{DIGITS}g}")
