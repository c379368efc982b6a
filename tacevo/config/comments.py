"""The meaning of each setting, from the comments of the schema: those above its line, or the one behind it."""

import ast
from dataclasses import fields, is_dataclass
from pathlib import Path

from tacevo.config import schema


def comments() -> dict[str, str]:
    """Return the comment of every setting of a run by its key, such as `archive.niches`."""
    text = Path(schema.__file__).read_text(encoding="utf-8")
    classes = {node.name: node for node in ast.parse(text).body if isinstance(node, ast.ClassDef)}
    lines, said = text.splitlines(), {"seed": "of all that the search draws"}
    for group in fields(schema.RunConfig):
        if isinstance(group.type, type) and is_dataclass(group.type):
            for item in classes[group.type.__name__].body:
                if isinstance(item, ast.AnnAssign):
                    said[f"{group.name}.{ast.unparse(item.target)}"] = _said(lines, item)
    return said


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
