"""Parsing text that may be anything, with every failure a value."""

import ast
import threading
import warnings
from dataclasses import dataclass
from typing import Self

from tacevo.records import Reason

_FILTERS = threading.Lock()  # catch_warnings swaps a list that all threads share


@dataclass(frozen=True, slots=True)
class Problem:
    """Why a text cannot be used; the stage that met it makes a rejection of it."""

    reason: Reason
    #: One line for a person.
    detail: str
    #: Line on which the parser gave up, from 1; 0 where there is none.
    line: int = 0

    @classmethod
    def at(cls, reason: Reason, node: ast.AST | int, detail: str) -> Self:
        """Make a problem of a node or of a line number, which the detail then names."""
        line = node if isinstance(node, int) else getattr(node, "lineno", 0)
        return cls(reason, f"line {line}: {detail}", line)


def is_special(name: str) -> bool:
    """Say whether Python gives a name a meaning, e.g. `__init__`."""
    return name.startswith("__") and name.endswith("__")


def parse(text: str) -> ast.Module | Problem:
    """Parse source text; it comes as `str`, so a coding cookie in it has no effect."""
    try:
        with _FILTERS, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an invalid escape sequence in a docstring is no fault of the network
            return ast.parse(text)
    except SyntaxError as error:
        line = error.lineno or 0
        shown = (error.text or "").strip()[:80]
        return Problem(Reason.syntax, f"line {line}: {type(error).__name__}: {error.msg}: {shown!r}", line)
    except (RecursionError, MemoryError):
        return Problem(Reason.too_complex, "the parser ran out of stack: expressions are nested too deeply")
    except ValueError as error:
        return Problem(Reason.syntax, f"the text cannot be parsed: {error}")
