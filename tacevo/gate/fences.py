"""Markdown fences in a model's answer, as real models leave them."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum, auto

from tacevo.gate.tags import code_before_tags

#: The beginning of a statement that a model may put on the line of a fence or a tag.
STATEMENT = r"(?:@\w|class\s+\w+\s*(?:[(:]|$)|def\s+\w+\s*\(|import\s+\w|from\s+[\w.]+\s+import\b)"
#: A line with a fence: what stands before the sign, the sign, and what stands behind it.
_FENCE = re.compile(r"([^`~]*)(`{3,}|~{3,})([^`]*)")
_LANGUAGE = re.compile(r"[{.]*(\w*)[ \t]*(.*)")
_PYTHON = {"", "py", "python", "python3", "py3", "ipython", "pycon", "pytorch"}
#: Languages of what is read as if no fence stood around it: it may be sentences or code.
_TEXT = {"text", "plaintext", "txt", "plain"}
_QUOTES = re.compile("\"\"\"|'''")


class FenceKind(Enum):
    """The kind of a part of an answer."""

    python = auto()  # between fences that are marked as Python or not marked at all
    other = auto()  # between fences of another language
    prose = auto()  # not between fences, or between fences of text


@dataclass(frozen=True, slots=True)
class Part:
    """Neighbouring lines of an answer."""

    kind: FenceKind
    lines: Sequence[str]
    #: Number of the first of them in the answer, from 0.
    first: int
    #: Whether something after them shows that the model had finished them.
    closed: bool
    #: Number of the line that follows them and what closes them.
    end: int


@dataclass(frozen=True, slots=True)
class _Fence:
    """A line that opens a block."""

    kind: FenceKind
    sign: str
    #: The code on this line; usually there is none.
    code: list[str]


def parts_of(lines: Sequence[str]) -> Iterator[Part]:
    """Split an answer at its fences.

    A fence is three or more backticks or tildes. It opens a block at the beginning of a line, and behind a sentence or
    a tag if that cannot be inline code. It closes with the same sign, at least as often, at the beginning of a line or
    behind code, which is more than CommonMark 0.31, section 4.5, allows. A language behind that sign opens the next
    block. A sign in a string closes nothing, unless it is a docstring that never ends.
    """
    fence: _Fence | None = None
    first, quoting = 0, True
    while first < len(lines):
        read = _body(lines, first, fence, quoting=quoting)
        if read is None:  # happens once at most, so the lines are read twice at most
            quoting = False
            continue
        body, end, following = read
        kind, code = (fence.kind, fence.code) if fence else (FenceKind.prose, [])
        behind = end if following else min(end + 1, len(lines))
        yield Part(kind, [*code, *body], first - len(code), closed=end < len(lines), end=behind)
        first, fence = end + 1, following


def _body(
    lines: Sequence[str], first: int, fence: _Fence | None, *, quoting: bool
) -> tuple[list[str], int, _Fence | None] | None:
    """Return the lines of a part, the number of the line that ends it, and the fence that this line opens.

    Return None where a docstring of it never ends.
    """
    body: list[str] = []
    docstring = ""
    for number in range(first, len(lines)):
        line = lines[number]
        before = docstring
        if quoting and (fence is None or fence.kind is FenceKind.python):
            docstring = _docstring(line, before)
        if not before and not docstring:
            if fence is None and (opened := _opened(line)):
                return body, number, opened
            if fence and (ending := _ending(line, fence.sign)):
                return body + ending[0], number, ending[1]
        body.append(line)
    return None if docstring else (body, len(lines), None)


def _docstring(line: str, quote: str) -> str:
    """Return the quotes of the docstring that is open after a line, if they were these before it; empty for none."""
    for sign in _QUOTES.findall(line):
        if quote in ("", sign):
            quote = "" if quote else sign
    return quote


def _opened(line: str) -> _Fence | None:
    """Return the fence that a line opens, if it opens one."""
    parts = _FENCE.fullmatch(line)
    if parts is None:
        return None
    before, sign, info = parts[1], parts[2], parts[3].strip()
    is_sentence = bool(before.strip())
    language, rest = ("", info) if re.match(STATEMENT, info) else _LANGUAGE.findall(info)[0]
    is_python = language.lower() in _PYTHON
    code = ("" if is_sentence else before) + rest if is_python and re.match(STATEMENT, rest) else ""
    if rest and not code and (is_sentence or not language):
        return None  # words about fences, or "```<|im_end|>", which closes a block
    if is_sentence and not (sign[0] == "`" and is_python and (info or before.rstrip()[-1] in ">:")):
        return None
    kind = FenceKind.prose if language.lower() in _TEXT else FenceKind.other
    return _Fence(FenceKind.python if is_python else kind, sign, [code] if code else [])


def _ending(line: str, sign: str) -> tuple[list[str], _Fence | None] | None:
    """Return the code before the sign that ends a block on this line, and the fence that opens the next block there."""
    if line.lstrip().startswith(sign):
        info = line.strip().lstrip(sign[0]).strip()
        following = _opened(line)
        is_next = following is not None and info and (following.kind is FenceKind.python or " " not in info)
        return [], following if is_next else None
    line = code_before_tags(line).rstrip()
    code, _, words = line.partition(sign)
    if words and not code.count('"') % 2 and not code.count("'") % 2 and "#" not in code:
        return [code], None
    code = line.rstrip(sign[0])
    return ([code], None) if len(line) - len(code) >= len(sign) else None
