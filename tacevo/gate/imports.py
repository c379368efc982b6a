"""The imports that the sandbox spares a candidate, written out, so that its source runs anywhere."""

import ast
import re

from tacevo.gate.names import names_of
from tacevo.text import parse_python

#: The names, and the line that imports each.
_GIVEN = {
    "torch": "import torch",
    "nn": "import torch.nn as nn",
    "F": "import torch.nn.functional as F",
    "math": "import math",
}


def with_imports(source: str) -> str:
    """Return a source with those imports that it leaves to the sandbox, so that it runs as a file."""
    tree = parse_python(source)
    lacked = names_of(tree.body).lacked
    missing = [line for name, line in _GIVEN.items() if name in lacked]
    if not missing:
        return source
    # A docstring and imports from `__future__` stay before everything else.
    first = 0
    for number, statement in enumerate(tree.body):
        is_docstring = number == 0 and isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
        is_future = isinstance(statement, ast.ImportFrom) and statement.module == "__future__"
        if not (is_docstring or is_future):
            break
        first = statement.end_lineno or 0
    lines = re.split(r"(?<=\n)", source)  # as Python counts them; a form feed, say, ends none
    head, rest = "".join(lines[:first]), "".join(lines[first:])
    return "\n".join([head, *missing, rest] if head else [*missing, "", "", rest])
