"""Text that is shown to a person: counted nouns, lists, tables, and control characters made harmless."""

from collections.abc import Iterable, Sequence

from tacevo.records import MISREPORTING


def counted(number: int, noun: str) -> str:
    """Write a number with its noun: `1 image`, `2 images`.

    Args:
        number: at least 0.
        noun: in the singular; its plural ends in `s`.
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def listed(words: Iterable[str], nothing: str = "none") -> str:
    """Write words with commas: `probe, train`; or another word where there are none."""
    return ", ".join(words) or nothing


def printable(text: str) -> str:
    r"""Write control characters, and those that turn the direction of a line, as escapes such as `\x1b`.

    Line breaks and tabs stay.
    """
    return "".join(letter if letter.isprintable() or letter in "\n\t" else _escaped(letter) for letter in text)


def _escaped(letter: str) -> str:
    return letter.encode("unicode_escape").decode("ascii")


def misreported(rejected: Iterable[tuple[str, int]]) -> list[str]:
    """Return a line with how many first answers were rejected for misreporting themselves; no line where none was.

    Args:
        rejected: reasons with counts of first answers; a reason may come once for each stage.
    """
    counts = {reason.value: 0 for reason in MISREPORTING}
    for reason, count in rejected:
        if reason in counts:
            counts[reason] += count
    found = ", ".join(f"{reason} {count}" for reason, count in counts.items() if count)
    return [f"Rejected for misreporting themselves (docs/gate.md): {sum(counts.values())} ({found})."] if found else []


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Write a Markdown table whose columns line up in plain text, too."""
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    lines = [header, ["-" * width for width in widths], *rows]
    return "\n".join(
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |" for line in lines
    )
