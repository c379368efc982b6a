"""The meaning of each setting, from the comments of the schema: those above its line, or the one behind it."""

import ast
import sys
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path

from tacevo.config import schema


def comments() -> dict[str, str]:
    """Return the comment of every setting of a run by its key, such as `archive.niches`."""
    said = {"seed": "of all that the search draws"}
    for group in fields(schema.RunConfig):
        if isinstance(group.type, type) and is_dataclass(group.type):
            said |= {f"{group.name}.{name}": words for name, words in comments_of(group.type).items()}
    return said


def comments_of(record: type) -> dict[str, str]:
    """Return the comment of every field that a class of a module itself has, by its name; empty where it has none."""
    return _in_module(record.__module__)[record.__name__]


@cache
def _in_module(name: str) -> dict[str, dict[str, str]]:
    """Return the comments in a module that was imported, by class, then by field."""
    text = Path(str(sys.modules[name].__file__)).read_text(encoding="utf-8")
    lines, classes = text.splitlines(), (node for node in ast.parse(text).body if isinstance(node, ast.ClassDef))
    return {
        made.name: {
            ast.unparse(item.target): _said(lines, item) for item in made.body if isinstance(item, ast.AnnAssign)
        }
        for made in classes
    }


def _said(lines: list[str], field: ast.AnnAssign) -> str:
    """Return the comment behind a field, or else above it."""
    _, mark, behind = lines[(field.end_lineno or field.lineno) - 1].partition("#:")
    if mark:
        return behind.strip()
    words: list[str] = []
    for line in reversed(lines[: field.lineno - 1]):
        if not line.strip().startswith("#:"):
            break
        words.insert(0, line.strip().removeprefix("#:").strip())
    return " ".join(words)
