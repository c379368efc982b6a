"""One clean line of text from anything a candidate raised or sent."""

import re

#: Longest detail that a rejection carries, in characters.
LONGEST = 300

_ADDRESS = re.compile(r"\b0x[0-9a-fA-F]{4,}")  # and not the middle of a shape such as 30400x64


def one_line(text: str) -> str:
    """Cut text to its first line that says something, printable only, addresses scrubbed, at most 300 characters.

    Memory addresses differ between runs, and control characters would speak to the terminal of whoever reads
    the detail.
    """
    lines = (line.strip() for line in text[: 100 * LONGEST].splitlines())
    first = next((line for line in lines if line), "")
    return "".join(c if c.isprintable() else "?" for c in _ADDRESS.sub("0x...", first))[:LONGEST]


def describe(error: BaseException) -> str:
    """Say what an exception is: its type and the first line of its message, as `one_line` cuts them."""
    name = type(error).__name__
    try:
        message = one_line(str(error))
    except Exception:  # a candidate's exception class may fail even here
        message = "(its message cannot be read)"
    return one_line(f"{name}: {message}" if message else name)
