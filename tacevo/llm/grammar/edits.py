"""A network written as edits of another one: search and replace, as requests ask for them."""

from collections.abc import Sequence
from difflib import SequenceMatcher


def edits(parent: str, child: str) -> str:
    """Return edits that turn the lines of a parent, which is not blank, into those of a child.

    Return the child itself where it is the parent again, or is shorter than its edits.

    The lines that an edit searches for are those that change, and as many around them as make them stand there once.
    """
    old, new = parent.split("\n"), child.rstrip("\n").split("\n")
    matcher = SequenceMatcher(None, old, new, autojunk=False)
    changes = [(a, b, d - c - (b - a)) for tag, a, b, c, d in matcher.get_opcodes() if tag != "equal"]
    spans: list[tuple[int, int]] = []
    for first, last in sorted(_alone(old, a, b) for a, b, _ in changes):
        before = spans.pop() if spans and first <= spans[-1][1] else (first, last)
        spans.append((before[0], max(last, before[1])))
    written = ""
    for first, last in spans:
        start = first + sum(longer for a, _, longer in changes if a < first)
        end = last + sum(longer for a, _, longer in changes if a <= last)
        written += _edit(old[first:last], new[start:end])
    return written if 0 < len(written) < len(child) else child


def _alone(lines: Sequence[str], first: int, last: int) -> tuple[int, int]:
    """Widen a span of lines until what stands there is not blank, and stands there alone."""
    while not any(line.strip() for line in lines[first:last]) or _count(lines, lines[first:last]) > 1:
        first, last = max(first - 1, 0), min(last + 1, len(lines))
    return first, last


def _count(lines: Sequence[str], part: Sequence[str]) -> int:
    return sum(lines[at : at + len(part)] == part for at in range(len(lines) - len(part) + 1))


def _edit(searched: Sequence[str], replaced: Sequence[str]) -> str:
    return "\n".join(["<<<<<<< SEARCH", *searched, "=======", *replaced, ">>>>>>> REPLACE"]) + "\n"
