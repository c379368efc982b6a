"""Cutting a model's answer into blocks of code."""

import ast
import keyword
import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

from tacevo.gate.fences import STATEMENT, FenceKind, Part, parts_of
from tacevo.gate.policy.problems import Problem, parse
from tacevo.gate.tags import LEADING, code_after_tags, code_before_tags, is_tagged

#: The most characters that may be parsed to read one answer, over all attempts: ten times an answer of 100,000 bytes,
#: or two seconds of work. The recorded answers take up to four times their length. It is a count of characters and not
#: a limit of time because a verdict may not depend on the machine.
MOST_PARSED = 1_000_000
#: The most blocks of code that an answer may have; the recorded ones have up to 3.
MOST_BLOCKS = 100
_CODE_START = re.compile(rf"{LEADING}(?:{STATEMENT}|[A-Z][A-Z0-9_]*\s*=|[A-Z]\w*\s*=\s*[A-Z]\w*\s*$)")
_CONTINUATION = re.compile(r"[#)\]}]")
#: A line that is code and not a sentence, by its beginning or as a whole, whether or not it parses.
_CODE = re.compile(
    r"""[ \t]*(?:@\w|(?:def|class)\s+\w+\s*(?:[(:\[]|$)|(?:import|from)\s+[\w.]+|return\b|raise\b|del\s
    |self\.|super\(|[\w.\[\]'", ]+(?:[-+*/%@&|^]|//|\*\*)?=(?!=)|[\w.]+\((?:.*\))?\s*(?:\#.*)?$|[)\]}]|['"]{3}
    |(?:if|for|while|with|try|else|elif|except|finally|match|case)\b.*:\s*$)""",
    re.VERBOSE,
)


#: A word of Python, which may stand beside another word in code.
_KEYWORDS = "|".join([*keyword.kwlist, "match", "case", "type", "print"])
_TWO_WORDS = re.compile(rf"\b(?!(?:{_KEYWORDS}|\d+)\b)\w+[ ]+(?!(?:{_KEYWORDS})\b)[A-Za-z]\w*")
#: The parts of a line in which two words are not looked for: arguments, strings and comments.
_ASIDE = re.compile(r"\(.*\)|\(.*|\"[^\"]*\"|'[^']*'|#.*")
_HEADING = re.compile(r"^\W*[A-Z][^=(){}\[\]]*:\W*$")
_STATES = re.compile(r"[ \t]*(?:class|def|async|self|return|super)\b|[ \t]*@|[ \t]*[\w, ]+=.*\bself\.")
#: A command of a notebook or a shell.
_COMMAND = re.compile(r"[ \t]*(?:!\w|%%?\w|\$[ \t])")


class TooComplexError(Exception):
    """An answer would take too much work to read; the message says how much may be."""


@dataclass(slots=True)
class BlockParser:
    """Parses parts of one answer, up to a number of characters in all."""

    left: int = MOST_PARSED

    def parse(self, text: str) -> ast.Module | Problem:
        """Parse a text.

        Raises:
            TooComplexError: too many characters were parsed already.
        """
        self.left -= len(text)
        if self.left < 0:
            raise TooComplexError(
                f"expected an answer that can be read by parsing {MOST_PARSED} characters; it takes more"
            )
        return parse(text)


@dataclass(frozen=True, slots=True)
class CodeBlock:
    """A stretch of an answer that may be code."""

    #: Dedented, without blank lines around it.
    text: str
    parsed: ast.Module | Problem
    #: Whether something after the block shows that the model had finished it.
    closed: bool
    #: Numbers of its first line in the answer, and of the line that follows it.
    start: int
    end: int
    #: The changes to the text, as a person would say them, and the name that its class had.
    notes: tuple[str, ...] = ()
    was: str = ""


def trimmed(text: str) -> str:
    """Dedent a text and drop the blank lines around it."""
    return textwrap.dedent(text).strip("\n").rstrip()


def blocks_of(text: str, parser: BlockParser) -> list[CodeBlock]:
    """Collect the blocks of an answer, in its order.

    These are what stands between fences that are marked as Python or not marked at all, and elsewhere the longest
    stretches of lines that start like code and parse. A class statement outside of fences that does not parse is a
    block, too, but not one between fences of another language.

    Raises:
        TooComplexError: there are too many, or they take too much work.
    """
    parts = parts_of(text.split("\n"))
    every = (
        block for part in parts for block in (_fenced if part.kind is FenceKind.python else _stretches)(part, parser)
    )
    blocks = list(islice(every, MOST_BLOCKS + 1))
    if len(blocks) > MOST_BLOCKS:
        raise TooComplexError(f"expected an answer with at most {MOST_BLOCKS} blocks of code; got more")
    return blocks


def _fenced(part: Part, parser: BlockParser) -> Iterator[CodeBlock]:
    """Read what stands between two fences: one block, unless a tag or a sentence keeps it from being parsed."""
    text = trimmed("\n".join(part.lines))
    parsed = parser.parse(text)
    if isinstance(parsed, Problem):
        if any(map(is_tagged, part.lines)):
            yield from _stretches(part, parser)
            return
        block = _between_sentences(part, parser)
        if block is not None:
            yield block
            return
    yield CodeBlock(text, parsed, part.closed, part.first, part.first + len(part.lines))


def is_code(line: str) -> bool:
    """Return whether a line is code, whether or not it parses."""
    return _COMMAND.match(line) is not None or (_CODE.match(line) is not None and not is_sentence(line))


def is_sentence(line: str) -> bool:
    """Return whether a line has two words side by side, which code has not."""
    return _TWO_WORDS.search(_ASIDE.sub(" ", line)) is not None


def _between_sentences(part: Part, parser: BlockParser) -> CodeBlock | None:
    """Read code with sentences before or behind it, as where a fence was never closed; None where it is not so."""
    lines = list(part.lines)
    start = next((at for at, line in enumerate(lines) if _CODE_START.match(line)), len(lines))
    if any(map(is_code, lines[:start])):
        return None
    end, parsed = _parsable(lines, start, parser) if start < len(lines) else (start, None)
    if parsed is None or not _are_words_or_use(lines[end:]):
        return None
    closed = part.closed or any(line.strip() for line in lines[end:])
    text = _statements(trimmed("\n".join(lines[start:end])), parsed)
    return CodeBlock(text, parsed, closed, part.first + start, part.first + end)


def _are_words_or_use(lines: Sequence[str]) -> bool:
    """Return whether lines are no code, or a heading and code below it that states nothing: `Usage:`, `net = Net()`."""
    code = [line for line in lines if is_code(line)]
    heading = next((line for line in lines if line.strip()), "")
    return not code or (_HEADING.search(heading) is not None and not any(map(_STATES.match, code)))


def _stretches(part: Part, parser: BlockParser) -> Iterator[CodeBlock]:
    """Find code where no fence says what is code."""
    lines = list(part.lines)
    start = 0
    while start < len(lines):
        end = start
        parsed: ast.Module | Problem | None = None
        if _CODE_START.match(lines[start]):
            lines[start] = code_after_tags(lines[start])
            end, parsed = _parsable(lines, start, parser)
            if parsed is None and part.kind is not FenceKind.other and _states_class(lines, start):
                end = _suite_end(lines, start)
                parsed = parser.parse(trimmed("\n".join(lines[start:end])))
        if parsed is not None:
            text = trimmed("\n".join(lines[start:end]))
            is_ended = lines[end - 1] != part.lines[end - 1]
            closed = part.closed or is_ended or any(line.strip() for line in lines[end:])
            yield CodeBlock(_statements(text, parsed), parsed, closed, part.first + start, part.first + end)
        start = max(end, start + 1)


def _parsable(lines: list[str], start: int, parser: BlockParser) -> tuple[int, ast.Module | None]:
    """Find where the longest parsable stretch from `start` ends, and its tree.

    A stretch is only ever cut before a line at its own indentation: a class with an error inside must fail, not
    lose its second half. It may also be cut behind a line that a tag ends; the tag is then dropped from `lines`.

    Returns:
        The first line after the stretch (`start` itself where nothing parses), and its tree.
    """
    margin = _indentation(lines[start])
    end = next((i for i in range(start, len(lines)) if _is_outside(lines[i], margin)), len(lines))
    while end > start:
        parsed = parser.parse(trimmed("\n".join(lines[start:end])))
        if isinstance(parsed, ast.Module):
            return end, parsed
        last = min(start + max(parsed.line - 1, 0), end - 1)
        code = code_before_tags(lines[last])
        if code != lines[last] and not _goes_on(lines, last, margin):
            lines[last], end = code, last + 1
        else:
            end = next((i for i in range(last, start, -1) if _begins_statement(lines[i], margin)), start)
    return start, None


def _indentation(line: str) -> int:
    return len(line) - len(line.lstrip())


def _is_outside(line: str, margin: int) -> bool:
    return bool(line.strip()) and _indentation(line) < margin


def _begins_statement(line: str, margin: int) -> bool:
    """Return whether a line at the margin could begin a statement; comments and closing brackets do not."""
    return bool(line.strip()) and _indentation(line) == margin and not _CONTINUATION.match(line[margin:])


def _goes_on(lines: Sequence[str], at: int, margin: int) -> bool:
    """Return whether the next line is indented by more than the margin."""
    following = next((lines[i] for i in range(at + 1, len(lines)) if lines[i].strip()), "")
    return _indentation(following) > margin


def _states_class(lines: Sequence[str], start: int) -> bool:
    """Tell a class statement from a sentence: the next line is indented below it."""
    return lines[start].lstrip().startswith("class") and _goes_on(lines, start, _indentation(lines[start]))


def _suite_end(lines: Sequence[str], start: int) -> int:
    """Find the next line that could begin a statement beside or outside the one at `start`."""
    margin = _indentation(lines[start])
    later = range(start + 1, len(lines))
    ends = (i for i in later if _is_outside(lines[i], margin) or _begins_statement(lines[i], margin))
    return next(ends, len(lines))


def _statements(text: str, parsed: ast.Module | Problem) -> str:
    """Drop what follows the last statement, such as a Markdown heading that reads as a comment."""
    last = parsed.body[-1].end_lineno if isinstance(parsed, ast.Module) else None
    return "\n".join(text.split("\n")[:last])
