"""An answer that is edits of a network that the model was given: search and replace, exactly or not at all.

The rules, in order:

1. An answer with a line that is a mark of an edit, or nearly one, is edits; any other is read as ever. Thoughts are
   left out before that (`tacevo.gate.tags`).
2. An edit is the lines between `<<<<<<< SEARCH` and `=======`, and those between that and `>>>>>>> REPLACE`, each mark
   on a line of its own. Words and fences around edits do not count; the class beside them makes the answer ambiguous.
3. The lines searched for stand in the network exactly once, as whole lines with their indentation. All edits refer to
   the network as it was given, so their order does not matter, and they do not overlap.
4. The result is read as an answer that is nothing but this text, and goes through the whole gate: what an edit may
   make of a network, within its class and beside it, is what any answer may.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from tacevo.gate.policy.problems import Problem
from tacevo.gate.tags import mentions_thought, without_thoughts
from tacevo.records import Reason
from tacevo.text import counted

_SEARCH, _MIDDLE, _REPLACE = "<<<<<<< SEARCH", "=======", ">>>>>>> REPLACE"

#: A line that is a mark of an edit, or nearly one.
_MARK = re.compile(r"[ \t]*(?:<{5,}|>{5,})(?:[ \t].*)?")

#: What the details of malformed edits say.
_EXPECTED = (
    f"expected edits of the form `{_SEARCH}`, lines, `{_MIDDLE}`, lines, `{_REPLACE}`, each mark on a line of its own"
)


@dataclass(frozen=True, slots=True)
class _Edit:
    """One edit of an answer."""

    searched: Sequence[str]
    replaced: Sequence[str]


def patched(answer: str, given: str, name: str, *, cut_off: bool) -> str | Problem | None:
    """Return a network after the edits of an answer.

    Args:
        answer: its lines end with a line feed alone.
        given: the network as the model was given it.
        name: of its class.
        cut_off: whether the answer was, or may have been, cut off.

    Returns:
        The text; a problem where the edits cannot be applied; None where the answer has none.
    """
    text = without_thoughts(answer, ()) if mentions_thought(answer) else answer
    lines = text.split("\n")
    if not any(map(_MARK.fullmatch, lines)):
        return None
    read = _edits_of(lines)
    if read is None:
        return (
            Problem(Reason.truncated, "the answer was cut off") if cut_off else Problem(Reason.misfit_edit, _EXPECTED)
        )
    edits, beside = read
    if re.search(rf"^[ \t]*class[ \t]+{re.escape(name)}\b", "\n".join(beside), re.MULTILINE):
        return Problem(Reason.ambiguous, f"expected edits or the whole class {name}; got both")
    return _applied(edits, given.split("\n"))


def _edits_of(lines: Sequence[str]) -> tuple[list[_Edit], list[str]] | None:
    """Return the edits among lines, and the lines beside them; None where a mark is missing or is not one."""
    edits: list[_Edit] = []
    beside: list[str] = []
    parts: list[list[str]] = []
    for line in lines:
        mark = line.strip()
        if mark == _SEARCH and not parts:
            parts = [[]]
        elif mark == _MIDDLE and len(parts) == 1:
            parts.append([])
        elif mark == _REPLACE and len(parts) == 2:
            edits.append(_Edit(*parts))
            parts = []
        elif _MARK.fullmatch(line):
            return None
        else:
            (parts[-1] if parts else beside).append(line)
    return None if parts else (edits, beside)


def _applied(edits: Sequence[_Edit], given: Sequence[str]) -> str | Problem:
    """Apply edits to the lines of a network, from its end to its beginning."""
    places: list[tuple[int, int, Sequence[str]]] = []
    for number, edit in enumerate(edits, 1):
        which, length = f"edit {number} of {len(edits)}", len(edit.searched)
        if not any(line.strip() for line in edit.searched):
            return Problem(Reason.misfit_edit, f"{which}: expected lines to search for; got none")
        found = [at for at in range(len(given) - length + 1) if list(given[at : at + length]) == edit.searched]
        if len(found) != 1:
            times = f"{counted(len(found), 'place')} in it" if found else "none; repeat them with their indentation"
            return Problem(
                Reason.misfit_edit, f"{which}: expected lines that stand in the parent exactly once; got {times}"
            )
        places.append((found[0], found[0] + length, edit.replaced))
    places.sort()
    if any(end > start for (_, end, _), (start, _, _) in pairwise(places)):
        return Problem(Reason.misfit_edit, "expected edits that do not overlap; got some that do")
    text = list(given)
    for start, end, replaced in reversed(places):
        text[start:end] = replaced
    return "\n".join(text)
