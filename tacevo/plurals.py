"""Numbers with their nouns, for whatever is shown to a person."""


def counted(number: int, noun: str) -> str:
    """Write a number with its noun: `1 image`, `2 images`.

    Args:
        number: at least 0.
        noun: in the singular; its plural ends in `s`.
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
