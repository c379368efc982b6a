"""The problems of a candidate's text, and the parser that finds the first ones."""

import ast
from dataclasses import dataclass
from typing import Self

from tacevo.records import Reason
from tacevo.text import parse_python


@dataclass(frozen=True, slots=True)
class Problem:
    """The problem for which a text cannot be used; its stage turns this into a rejection."""

    reason: Reason
    #: One line for a person.
    detail: str
    #: Line on which the parser gave up, from 1; 0 where there is none.
    line: int = 0

    @classmethod
    def at(cls, reason: Reason, node: ast.AST | int, detail: str) -> Self:
        """Make a problem of a node or of a line number, and name the line in the detail."""
        line = node if isinstance(node, int) else getattr(node, "lineno", 0)
        return cls(reason, f"line {line}: {detail}", line)


def parse(text: str) -> ast.Module | Problem:
    """Parse source text; it comes as `str`, so a coding cookie in it has no effect."""
    try:
        return parse_python(text)
    except SyntaxError as error:
        line = error.lineno or 0
        shown = (error.text or "").strip()[:80]
        return Problem(Reason.syntax, f"line {line}: {type(error).__name__}: {error.msg}: {shown!r}", line)
    except (RecursionError, MemoryError):
        return Problem(Reason.too_complex, "expressions are nested too deeply for the parser; simplify them")
    except ValueError as error:
        return Problem(Reason.syntax, f"the text cannot be parsed: {error}")
