"""Numbers with their nouns, and lists, for whatever is shown to a person."""

from collections.abc import Iterable


def counted(number: int, noun: str) -> str:
    """Write a number with its noun: `1 image`, `2 images`.

    Args:
        number: at least 0.
        noun: in the singular; its plural ends in `s`.
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def listed(words: Iterable[str], nothing: str = "none") -> str:
    """Write words one after the other: `probe, train`; or what stands where there is none."""
    return ", ".join(words) or nothing
