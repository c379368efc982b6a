"""Cutting a model's answer into blocks of code."""

import ast
import re
import textwrap
from dataclasses import dataclass
from typing import Self

from tacevo.gate.policy.problems import parse

#: How many characters may be parsed to find code between prose, over all attempts: a second or two of work, and about a
#: hundred attempts for an answer of usual size.
_BUDGET = 500_000

_FENCE = re.compile(r"[ \t]*(`{3,}|~{3,})[ \t]*([^`\n]*)")

_LANGUAGE = re.compile(r"[{.]*(\w*)")

_PYTHON = {"", "py", "python", "python3", "py3"}

_CODE_START = re.compile(
    r"[ \t]*(@\w|class\s+\w+\s*[(:]|def\s+\w+\s*\(|import\s+\w|from\s+[\w.]+\s+import\b|[A-Z][A-Z0-9_]*\s*=)"
)

_CONTINUATION = re.compile(r"[#)\]}]")


@dataclass(frozen=True, slots=True)
class Block:
    """A stretch of an answer that may be code."""

    text: str
    #: Whether something after the block shows that the model had finished it.
    closed: bool

    @classmethod
    def of(cls, text: str, *, closed: bool) -> Self:
        """Make a block of dedented text without blank lines around it."""
        return cls(textwrap.dedent(text).strip("\n").rstrip(), closed)


def fenced_blocks(text: str) -> list[Block]:
    """Collect the blocks between Markdown fences that are marked as Python or not marked at all.

    A fence is three or more backticks or tildes; it closes with the same sign, at least as often, alone on its
    line (CommonMark 0.31, section 4.5). The last one may be left open.
    """
    blocks = []
    opened: re.Match[str] | None = None
    lines: list[str] = []
    for line in text.split("\n"):
        fence = _FENCE.fullmatch(line)
        if opened is None:
            opened, lines = fence, []
        elif fence and fence[1].startswith(opened[1]) and not fence[2].strip():
            blocks += _python_block(opened, lines, closed=True)
            opened = None
        else:
            lines.append(line)
    if opened is not None:
        blocks += _python_block(opened, lines, closed=False)
    return blocks


def _python_block(fence: re.Match[str], lines: list[str], *, closed: bool) -> list[Block]:
    """Make a block of the lines after a fence, or none where its first word names another language."""
    language = _LANGUAGE.match(fence[2])
    is_python = language is not None and language[1].lower() in _PYTHON
    return [Block.of("\n".join(lines), closed=closed)] if is_python else []


def parsable_blocks(text: str) -> list[Block]:
    """Collect the longest stretches of lines that start like code and parse, from text without fences."""
    lines = text.split("\n")
    blocks = []
    start, budget = 0, _BUDGET
    while start < len(lines) and budget > 0:
        end = start
        if _CODE_START.match(lines[start]):
            end, budget = _parsable_end(lines, start, budget)
        if end > start:
            closed = any(line.strip() for line in lines[end:])
            blocks.append(Block.of(_statements(lines[start:end]), closed=closed))
        start = max(end, start + 1)
    return blocks


def _parsable_end(lines: list[str], start: int, budget: int) -> tuple[int, int]:
    """Find where the longest parsable stretch from `start` ends, and what is left of the budget.

    A stretch is only ever cut before a line at its own indentation: a class with an error inside must fail, not
    lose its second half.

    Returns:
        The first line after the stretch (`start` itself where nothing parses), and the characters left to parse.
    """
    margin = _indentation(lines[start])
    end = next((i for i in range(start, len(lines)) if _is_outside(lines[i], margin)), len(lines))
    while end > start and budget > 0:
        text = textwrap.dedent("\n".join(lines[start:end]))
        budget -= len(text)
        problem = parse(text)
        if isinstance(problem, ast.Module):
            return end, budget
        last = start + max(problem.line - 1, 0)
        end = next((i for i in range(min(last, end - 1), start, -1) if _begins_statement(lines[i], margin)), start)
    return start, budget


def _indentation(line: str) -> int:
    return len(line) - len(line.lstrip())


def _is_outside(line: str, margin: int) -> bool:
    return bool(line.strip()) and _indentation(line) < margin


def _begins_statement(line: str, margin: int) -> bool:
    """Return whether a line at the margin could begin a statement; comments and closing brackets do not."""
    return bool(line.strip()) and _indentation(line) == margin and not _CONTINUATION.match(line[margin:])


def _statements(lines: list[str]) -> str:
    """Drop what follows the last statement, such as a Markdown heading that reads as a comment."""
    text = textwrap.dedent("\n".join(lines))
    tree = parse(text)
    last = tree.body[-1].end_lineno if isinstance(tree, ast.Module) else None
    return "\n".join(text.split("\n")[:last])
