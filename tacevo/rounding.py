"""The rounding of computed numbers: the digits that are kept, and those that are shown.

Special functions and wide loops differ in their last bits between CPUs (docs/determinism.md), so
numbers are rounded before they enter a file or a table.
"""

#: Significant digits of losses, metrics and statistics.
DIGITS = 9


def rounded(value: float) -> float:
    """Keep 9 significant digits: more than any table shows, and none that depends on the CPU."""
    return float(f"{value:.{DIGITS}g}")


#: Below this a number is shown with an exponent.
SMALLEST = 1e-4


def significant(value: float, digits: int = 3) -> str:
    """Write a number with so many significant digits, and all before its point: 0.00612, 12.3, 1,235, 1.23e-05."""
    if 0 < abs(value) < SMALLEST:
        return f"{value:.{digits - 1}e}"
    return f"{value:,.{decimals(value, digits)}f}"


def decimals(value: float, digits: int) -> int:
    """Count the decimals that give a number so many significant digits, once it is rounded to them."""
    if value == 0:
        return digits - 1
    exponent = int(f"{abs(value):.{digits - 1}e}".partition("e")[2])  # of 9.996 as of 10.0
    return max(digits - 1 - exponent, 0)
