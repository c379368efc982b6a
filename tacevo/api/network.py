"""A candidate's network in this process, where its code runs unconfined."""

import ast
import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, cast

from tacevo.records import Contract

if TYPE_CHECKING:
    from torch import nn

#: What the sandbox gives a candidate without an import, and the line that imports it.
_GIVEN = {
    "torch": "import torch",
    "nn": "import torch.nn as nn",
    "F": "import torch.nn.functional as F",
    "math": "import math",
}


def with_imports(source: str) -> str:
    """Return a source with those imports that it leaves to the sandbox, so that it runs as a file."""
    tree = ast.parse(source)
    names = [node for node in ast.walk(tree) if isinstance(node, ast.Name)]
    bound = {node.id for node in names if not isinstance(node.ctx, ast.Load)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            bound |= {(alias.asname or alias.name).partition(".")[0] for alias in node.names}
    used = {node.id for node in names}
    missing = [line for name, line in _GIVEN.items() if name in used - bound]
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
    lines = source.splitlines(keepends=True)
    head, rest = "".join(lines[:first]), "".join(lines[first:])
    return "\n".join([head, *missing, rest] if head else [*missing, "", "", rest])


def build(source: str, name: str, contract: Contract) -> "nn.Module":
    """Construct a candidate's network with fresh weights, drawn by torch's generator of this process.

    Raises:
        Exception: what the source raises.
    """
    torch = importlib.import_module("torch")  # here alone: commands and searches never import it
    module = ModuleType(name)
    sys.modules[name] = module  # where dataclasses, type hints and pickle look its names up
    module.__dict__.update(torch=torch, nn=torch.nn, F=torch.nn.functional, math=importlib.import_module("math"))
    exec(compile(source, f"<{name}>", "exec"), module.__dict__)
    return cast("nn.Module", contract.construct(module.__dict__[contract.class_name]))
