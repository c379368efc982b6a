"""Numbers as people write them in tables and names: plain decimal digits, with an exponent perhaps."""

import math
import re

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", flags=re.ASCII)


def number_in(text: str) -> float | None:
    """Read a finite number such as `12`, `-.5` or `1.5e-3`, outer spaces aside.

    `float` also takes `1_000`, digits of other scripts, `nan` and `infinity`: what a slip or another program's mark for
    a missing value looks like.

    Returns:
        The number; None for anything else, and for one beyond the range of a float.
    """
    number = float(text) if _NUMBER.fullmatch(text.strip()) else math.nan
    return number if math.isfinite(number) else None
