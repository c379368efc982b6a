"""The facts of parts that are known without importing them: what each does, and what is not installed."""

import ast
import re
from importlib.metadata import PackageNotFoundError, requires

from tacevo.errors import ConfigError
from tacevo.parts.registry import EXTRAS, Part, is_there
from tacevo.parts.sources import files_of


def first_line_of(part: Part) -> str:
    """Return the first line of the docstring of a part, read from its source; empty where there is none.

    Of a function of ours that makes a part it is that of its module, since its own says how the part is made.
    """
    try:
        *_, file = files_of(part)
        tree = ast.parse(file.read_text(encoding="utf-8"))
    except (ConfigError, ImportError, OSError, SyntaxError, ValueError):
        return ""
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == part.attribute:
            is_maker = isinstance(node, ast.FunctionDef) and part.is_ours
            return (ast.get_docstring(tree if is_maker else node) or "").partition("\n")[0].strip()
    return ""


def lacking(part: Part) -> list[str]:
    """List what a part needs and is not installed: libraries of ours, distributions that a package requires."""
    if part.is_ours:
        extra = part.kind.extras.get(part.name)
        return [library for library, of in EXTRAS.items() if of == extra and not is_there(library)]
    try:
        needed = requires(part.origin.partition(" ")[0]) or []
    except PackageNotFoundError:  # a file
        return []
    return [name for line in needed if ";" not in line and not _is_installed(name := _name(line))]


def _name(requirement: str) -> str:
    """Return the name of a distribution in a requirement, as `torch` of `torch>=2.6`."""
    match = re.match(r"[A-Za-z0-9._-]+", requirement)
    return match[0] if match else requirement


def _is_installed(distribution: str) -> bool:
    try:
        requires(distribution)
    except PackageNotFoundError:
        return False
    return True
