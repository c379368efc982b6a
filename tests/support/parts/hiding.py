"""Tests without rooms: `--without-rooms` hides all of them from import, `--room NAME` all but one.

What is hidden is found neither by this process nor by any that it starts. A test that needs a room says so: it stands in
`tests/rooms/NAME`, or its file or itself has the mark `room`. Where that room is hidden, such a file is not even imported, and
such a test is deselected. All others must pass.
"""

import ast
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import MappingProxyType

import pytest
from rooms import HIDES, ROOMS

#: Rooms that work with the help of others.
WITH = MappingProxyType({"batches": ("hosted",), "document": ("figures", "motifs")})

#: Fixtures that need a room.
FIXTURES = MappingProxyType(
    {"empty_store": "mlflow", "uri": "mlflow", "browser": "page", "slurm": "slurm", "alone": "slurm"}
)

_TESTS = Path(__file__).resolve().parents[2]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add both options."""
    group = parser.getgroup("rooms")
    group.addoption("--without-rooms", action="store_true", help="hide all rooms (docs/design.md) from import")
    group.addoption("--room", choices=sorted(ROOMS), help="run the tests of this room, with all others hidden")


def pytest_configure(config: pytest.Config) -> None:
    """Hide what is to be hidden, before any test is imported."""
    config.addinivalue_line("markers", "room(*names): needs these rooms, and does not run where one is hidden")
    install(str(_TESTS / "support" / "own"))
    kept = kept_rooms(config)
    if kept == set(ROOMS):
        return
    shown = {name for room in kept for name in ROOMS[room].split()}
    hidden = [name for room in ROOMS.values() for name in room.split() if name not in shown]
    hides = f"NAMES = {hidden!r}\n{HIDES}"
    folder = tempfile.TemporaryDirectory(prefix="tacevo-hidden-")
    config.add_cleanup(folder.cleanup)
    Path(folder.name, "sitecustomize.py").write_text(hides, encoding="utf-8")
    install(folder.name)
    exec(hides, {})
    if imported := sorted(name for name in sys.modules if name in hidden):
        raise pytest.UsageError(f"expected that no room is imported before it is hidden; got {imported}")


def install(folder: str) -> None:
    """Have this process and those that it starts find what lies in a directory."""
    sys.path.insert(0, folder)
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [folder, os.environ.get("PYTHONPATH")]))


def kept_rooms(config: pytest.Config) -> set[str]:
    """Return the rooms that are not hidden."""
    if room := config.getoption("room"):
        return {room, *WITH.get(room, ())}
    return set() if config.getoption("without_rooms") else set(ROOMS)


class _OfRooms(pytest.File):
    """A file that needs what is hidden."""

    def collect(self) -> Iterator[pytest.Item]:
        return iter(())


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Leave a file unimported that says that it needs a room which is hidden."""
    if _needed(module_path) <= kept_rooms(parent.config):
        return None
    parent.config.stash.setdefault(_LEFT, []).append(module_path)
    return _OfRooms.from_parent(parent, path=module_path)


_LEFT = pytest.StashKey[list[Path]]()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect tests that need a room which is hidden, and with `--room` those that do not need this one."""
    room, kept = config.getoption("room"), kept_rooms(config)
    needed = [_needed_by(item) for item in items]
    runs = [rooms <= kept and (room is None or room in rooms) for rooms in needed]
    config.hook.pytest_deselected(items=[item for item, does in zip(items, runs, strict=True) if not does])
    items[:] = [item for item, does in zip(items, runs, strict=True) if does]


def _needed_by(item: pytest.Item) -> set[str]:
    marked = {name for mark in item.iter_markers("room") for name in mark.args}
    fixtures = {FIXTURES[name] for name in getattr(item, "fixturenames", ()) if name in FIXTURES}
    return marked | fixtures | _of_directory(item.path)


def _of_directory(path: Path) -> set[str]:
    parts = path.relative_to(_TESTS).parts
    return {parts[1].replace("_", " ")} if parts[0] == "rooms" else set()


def _needed(path: Path) -> set[str]:
    """Read the rooms that a file needs, without importing it."""
    rooms, text = _of_directory(path), path.read_text(encoding="utf-8")
    if "pytestmark = " in text:
        for statement in ast.parse(text).body:
            match statement:
                case ast.Assign(targets=[ast.Name(id="pytestmark")]):
                    rooms |= set(_names(statement))
    return rooms


def _names(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        match node:
            case ast.Call(func=ast.Attribute(attr="room"), args=names):
                yield from (name.value for name in names if isinstance(name, ast.Constant))
