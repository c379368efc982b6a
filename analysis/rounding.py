"""How a number is shown: one rule for all that people read.

    text                  as it is, escaped
    whole number          in full, thousands apart: 1,145,411
    number                three significant digits, all digits before the point: 0.00612, 12.3, 1,235;
                          below 0.0001 as 1.23e-05
    p-value               two significant digits, `<0.001` below that
    U                     counts in halves, so one decimal: 304.5
    percentage            one decimal: 96.0 %
    estimate [low, high]  all three with the decimals that give the largest of them three significant digits;
                          where that is below 0.0001, each is written as a number
    percentages           one decimal: 96.0 % [94.2, 97.1]
    nothing               an en dash

Halves go the way of the binary number, as Python's `format` rounds. A number that is not finite is an error.
"""

import re

from analysis.table import Cell, HalfInteger, Interval, Percent, PercentInterval, PValue, finite
from tacevo.rounding import SMALLEST, decimals, significant

_MINUS, _DASH = "\N{MINUS SIGN}", "\N{EN DASH}"

#: The sign of a number, not of an exponent.
_NEGATIVE = re.compile(r"(?<!e)-")


def shown(cell: Cell) -> str:
    """Round a cell by the rule above, as plain text.

    Raises:
        ValueError: it is NaN or infinite.
    """
    match cell:
        case None | str():
            return _DASH if cell is None else cell
        case int():
            text = f"{cell:,}"
        case PValue(value):
            text = "<0.001" if finite(value) < 0.001 else significant(value, 2)
        case HalfInteger(value):
            text = f"{finite(value):,.1f}"
        case Percent(value):
            text = f"{finite(value) * 100:.1f} %"
        case Interval(estimate, low, high):
            text = _interval(estimate, low, high)
        case PercentInterval(estimate, low, high):
            low_end, high_end = (f"{finite(value) * 100:.1f}" for value in (low, high))
            text = f"{finite(estimate) * 100:.1f} % [{low_end}, {high_end}]"
        case _:
            text = significant(finite(cell))
    return _NEGATIVE.sub(_MINUS, text)


def p_in_words(value: float) -> str:
    """Write a p-value with its relation: `= 0.012`, `< 0.001`."""
    text = shown(PValue(value))
    return f"< {text[1:]}" if text.startswith("<") else f"= {text}"


def _interval(estimate: float, low: float, high: float) -> str:
    values = [finite(value) for value in (estimate, low, high)]
    largest = max(map(abs, values))
    if 0 < largest < SMALLEST:
        texts = [significant(value) for value in values]
    else:
        texts = [f"{value:,.{decimals(largest, 3)}f}" for value in values]
    return f"{texts[0]} [{texts[1]}, {texts[2]}]"
