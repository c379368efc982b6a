"""Text of strangers, made fit for a terminal; pure."""


def printable(text: str) -> str:
    r"""Write letters that a terminal would obey, or that turn the direction of a line, as escapes such as `\x1b`.

    Line breaks and tabs stay.
    """
    return "".join(letter if letter.isprintable() or letter in "\n\t" else _escaped(letter) for letter in text)


def _escaped(letter: str) -> str:
    return letter.encode("unicode_escape").decode("ascii")
