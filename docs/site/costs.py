"""Count what the tables of docs/design.md say of rooms and promises: `python docs/site/costs.py` writes them anew.

A cell names modules in backticks, as `tacevo.llm.batches`, or files below tacevo/, as `storage/` and
`evolution/lines.py`, perhaps `without` some of them. The cell behind it says how many statements they have, without
docstrings. The site counts them when it is built.
"""

import ast
import re
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

PAGE = ROOT / "docs/design.md"

#: A row of rooms or of promises: what it is about, where that is, and how many statements it has.
_ROW = re.compile(r"^(?P<before>\|.*\| )(?P<where>[^|]*`[^|]*) \| (?P<count>[\d,]+)(?P<after> \|.*)$", re.MULTILINE)

#: The row of all that no room has.
_CORE = re.compile(r"^(\| core \| .* \| )[\d,]+( \| - \|)$", re.MULTILINE)


def statements(files: Iterable[Path]) -> int:
    """Count the statements of files, without docstrings."""
    nodes = (node for file in files for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
    return sum(isinstance(node, ast.stmt) and not _is_docstring(node) for node in nodes)


def _is_docstring(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def files_of(where: str) -> set[Path]:
    """Return the files that a cell names.

    Raises:
        FileNotFoundError: it names one that is not there.
    """
    named, _, without = where.partition(" without ")
    return {file for name in re.findall("`(.+?)`", named) for file in _files(name)} - (
        files_of(without) if without else set()
    )


def _files(name: str) -> set[Path]:
    if "/" not in name and not name.endswith(".py"):
        path = ROOT / name.replace(".", "/")
        found = {*path.rglob("*.py"), *([file] if (file := path.with_suffix(".py")).exists() else [])}
    else:
        below = ROOT / "tacevo" if (ROOT / "tacevo" / name).exists() else ROOT
        found = set((below / name).rglob("*.py")) if name.endswith("/") else {below / name} & set(below.rglob("*.py"))
    if not found:
        raise FileNotFoundError(f"docs/design.md names {name}, which is not there")
    return found


def counted(page: str) -> str:
    """Return the page with its statements as they are now."""
    rooms = set[Path]()

    def count(row: re.Match[str]) -> str:
        files = files_of(row["where"])
        rooms.update(files if row["after"].endswith("| yes |") else ())
        return f"{row['before']}{row['where']} | {statements(files):,}{row['after']}"

    page = _ROW.sub(count, page)
    core = files_of("`tacevo/`, `analysis/`") - rooms
    return _CORE.sub(lambda row: f"{row[1]}{statements(core):,}{row[2]}", page)


if __name__ == "__main__":
    PAGE.write_text(counted(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
