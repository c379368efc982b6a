"""Tests without rooms: `--without-rooms` hides all of them from import, `--room NAME` all but one.

What is hidden is found neither by this process nor by any that it starts. A test that needs a room says so: it stands
in `tests/rooms/NAME`, or its file or itself has the mark `room`. Where that room is hidden, such a file is not even
imported, and such a test is deselected. All others must pass.
"""

import ast
import os
import re
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import MappingProxyType

import commands
import pytest
from rooms import HIDES, ROOMS

#: What publishing needs: anybody must be able to make a bundle's tables and figures again.
PUBLISHING = (
    *("crate", "figures", "data check", "motifs", "image tests", "transfer", "published"),
    *("Pareto", "alarms", "effects of instructions", "noise"),
)

#: Rooms that work with the help of others, which stay with them.
WITH = MappingProxyType(
    {
        "batches": ("hosted",),
        "figures": ("data check",),  # both draw images, with Matplotlib
        "data check": ("figures", "simulator", "tacverse"),  # its tests look at their data
        "page": ("figures", "data check", "Pareto", "alarms"),  # which draw its sample images, and what it shows
        "document": ("figures", "data check", "motifs", "published"),
        "crate": PUBLISHING,
        "ray": ("gpus",),
        "table": ("grammar", "simulator", *PUBLISHING),  # of which its networks and images are; its runs are published
    }
)

#: Fixtures that need a room.
FIXTURES = MappingProxyType({"empty_store": "mlflow", "browser": "page", "slurm": "slurm", "alone": "slurm"})

_TESTS = Path(__file__).resolve().parents[2]

_LEFT = pytest.StashKey[list[Path]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add both options."""
    group = parser.getgroup("rooms")
    group.addoption("--without-rooms", action="store_true", help="hide all rooms (docs/design.md) from import")
    group.addoption("--room", type=_named, help="run the tests of this room, with all others hidden")


def _named(room: str) -> str:
    """Return the name of a room, which may be written as its directory's: `plans_pilots` for `plans, pilots`."""
    return {re.sub(r"\W+", "_", name.lower()): name for name in ROOMS}.get(room) or _one_of(room)


def _one_of(room: str) -> str:
    if room not in ROOMS:
        raise pytest.UsageError(f"expected one of {', '.join(ROOMS)}; got {room}")
    return room


def pytest_configure(config: pytest.Config) -> None:
    """Hide what is to be hidden, before any test is imported."""
    config.addinivalue_line("markers", "room(*names): needs these rooms, and does not run where one is hidden")
    _find_in(str(_TESTS / "support" / "own"))
    kept = kept_rooms(config)
    if kept == set(ROOMS):
        return
    shown = {name for room in kept for name in ROOMS[room].split()}
    hidden = [name for room in ROOMS.values() for name in room.split() if name not in shown]
    if imported := sorted(set(hidden) & sys.modules.keys()):
        raise pytest.UsageError(f"expected that no room is imported before it is hidden; got {imported}")
    hides = f"NAMES = {hidden!r}\n{HIDES}"
    folder = tempfile.TemporaryDirectory(prefix=commands.HIDES)
    config.add_cleanup(folder.cleanup)
    Path(folder.name, "sitecustomize.py").write_text(hides, encoding="utf-8")
    _find_in(folder.name)
    exec(hides, {})


def _find_in(folder: str) -> None:
    """Have this process and those that it starts find what lies in a directory."""
    sys.path.insert(0, folder)
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [folder, os.environ.get("PYTHONPATH")]))


def kept_rooms(config: pytest.Config) -> set[str]:
    """Return the rooms that are not hidden."""
    if room := config.getoption("room"):
        return {room, *WITH.get(room, ())}
    return set() if config.getoption("without_rooms") else set(ROOMS)


class _OfRooms(pytest.File):
    """A file that is left out."""

    def collect(self) -> Iterator[pytest.Item]:
        return iter(())


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Leave a file unimported that says that it needs a room which is hidden, or that has no test of the chosen one."""
    config, kept = parent.config, kept_rooms(parent.config)
    if kept == set(ROOMS):
        return None
    needed, named = _rooms_of(module_path)
    room = config.getoption("room")
    if needed <= kept and (room is None or room in needed | named):
        return None
    config.stash.setdefault(_LEFT, []).append(module_path)
    return _OfRooms.from_parent(parent, path=module_path)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect tests that need a room which is hidden, and with `--room` those that do not need this one."""
    room, kept = config.getoption("room"), kept_rooms(config)
    needed = [_needed_by(item) for item in items]
    runs = [rooms <= kept and (room is None or room in rooms) for rooms in needed]
    config.hook.pytest_deselected(items=[item for item, does in zip(items, runs, strict=True) if not does])
    items[:] = [item for item, does in zip(items, runs, strict=True) if does]


def pytest_report_collectionfinish(config: pytest.Config) -> str | None:
    """Say how many files are left out, since the number of deselected tests does not count theirs."""
    left = config.stash.get(_LEFT, [])
    return f"rooms hidden: {len(set(ROOMS) - kept_rooms(config))}; {len(left)} files not imported" if left else None


def _needed_by(item: pytest.Item) -> set[str]:
    marked = _spelled(name for mark in item.iter_markers("room") for name in mark.args)
    fixtures = {FIXTURES[name] for name in getattr(item, "fixturenames", ()) if name in FIXTURES}
    return marked | fixtures | _of_directory(item.path)


def _spelled(names: Iterable[str]) -> set[str]:
    """Return the rooms that a mark names; `publishing` stands for all that it needs."""
    return {_one_of(room) for name in names for room in (PUBLISHING if name == "publishing" else (name,))}


def _of_directory(path: Path) -> set[str]:
    if not path.is_relative_to(_TESTS / "rooms"):
        return set()
    return {_named(path.relative_to(_TESTS / "rooms").parts[0])}


def _rooms_of(path: Path) -> tuple[set[str], set[str]]:
    """Read, without importing it, which rooms a file needs, and which of its tests name further ones."""
    needed, named = _of_directory(path), set[str]()
    text = path.read_text(encoding="utf-8")
    if not re.search(r"mark\.room\(", text):
        return needed, named
    for statement in ast.parse(text).body:
        match statement:
            case ast.Assign(targets=[ast.Name(id="pytestmark")]):
                needed |= _spelled(_marks(statement))
            case _:
                named |= _spelled(_marks(statement))
    return needed, named


def _marks(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        match node:
            case ast.Call(func=ast.Attribute(attr="room", value=ast.Attribute(attr="mark")), args=names):
                yield from (str(name.value) for name in names if isinstance(name, ast.Constant))
