"""Whether the tests bite: `python -m benchmarks.mutants [--number N] [--seed S] [--rooms ROOM ...]`.

A mutant is the package with one small fault, such as `<` for `<=`, a number one larger, or a call left out. Faults are
drawn at random from all places of some rooms, as many of each room. No file is changed: a process of the tests, and
every process that it starts, gets the faulty module from a loader. First the room's own tests try to find the fault,
then those of the rooms above it. One line a mutant says which test found it, or that all of them passed; those that
live are read by a person, because some faults change nothing.
"""

import argparse
import ast
import itertools
import marshal
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

_ROOT = Path(__file__).parents[1]

#: By room: the directories of its modules, of its own tests, and of the tests above it that reach it.
ROOMS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]] = {
    "search": (("tacevo/evolution",), ("tests/evolution", "tests/rooms/surrogate"), ("tests/promises", "tests/runs")),
    "storage": (
        ("tacevo/storage",),
        ("tests/storage",),
        ("tests/promises", "tests/bundles", "tests/sweeps", "tests/parts"),
    ),
    "training": (("tacevo/training",), ("tests/training",), ("tests/promises", "tests/studies", "tests/runs")),
    "gate": (("tacevo/gate",), ("tests/gate",), ("tests/promises", "tests/runs", "tests/api")),
    "data": (
        ("tacevo/data",),
        ("tests/data", "tests/rooms/simulator", "tests/rooms/tacverse", "tests/rooms/data_check"),
        ("tests/runs", "tests/promises", "tests/rooms/table", "tests/cli"),
    ),
    "statistics": (
        ("analysis/statistics",),
        ("tests/analysis/statistics", "tests/rooms/noise", "tests/rooms/pareto", "tests/rooms/plans_pilots"),
        ("tests/analysis", "tests/studies", "tests/rooms/image_tests"),
    ),
    "results": (
        ("tacevo/results",),
        ("tests/results", "tests/rooms/noise", "tests/rooms/table"),
        ("tests/bundles", "tests/analysis", "tests/sweeps"),
    ),
    "api": (
        ("tacevo/api",),
        ("tests/api", "tests/rooms/plans_pilots", "tests/rooms/page", "tests/rooms/table"),
        ("tests/cli", "tests/bundles", "tests/reproduce", "tests/studies", "tests/parts", "tests/rooms/export"),
    ),
}

#: What needs hardware that is not here, so that no test can find a fault in it.
_LEFT_OUT = ("gpu.py", "captured.py", "cuda_libraries.py", "leases.py")

_COMPARED = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}

_COMPUTED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult}

#: Python imports it first in every process. The variable says which module has the fault, and where its code is.
_GIVES_MUTANT = """
import os, sys
from importlib.machinery import PathFinder, SourceFileLoader

NAME, CODE = os.environ["TACEVO_MUTANT"].split("=", 1)

class Mutant(SourceFileLoader):
    def get_code(self, fullname):
        with open(CODE, "rb") as file:
            return __import__("marshal").load(file)

class Giving(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        spec = PathFinder.find_spec(name, path, target)
        if name == NAME and spec is not None:
            spec.loader = Mutant(name, spec.origin)
        return spec

sys.meta_path = [Giving if finder is PathFinder else finder for finder in sys.meta_path]
"""


@dataclass(frozen=True, slots=True)
class Mutant:
    """A module with one fault."""

    room: str
    path: Path
    line: int
    #: The fault in words: the code before and after.
    fault: str
    tree: ast.Module

    @property
    def module(self) -> str:
        """The module's name."""
        return ".".join(self.path.with_suffix("").parts)


def main() -> int:
    """Try the tests on mutants; return 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutants", description=__doc__.partition("\n")[0])
    parser.add_argument("--number", type=int, default=64, help="of mutants (64)")
    parser.add_argument("--seed", type=int, default=1, help="of what is drawn (1)")
    parser.add_argument("--rooms", nargs="+", choices=ROOMS, default=list(ROOMS), help="all, unless some are named")
    options = parser.parse_args()
    drawn = draw(options.rooms, options.number, options.seed)
    say, lived = Console(width=200).out, []
    for number, mutant in enumerate(drawn, 1):
        begun = time.monotonic()
        found = finder(mutant)
        if found is None:
            lived.append(mutant)
        seconds = time.monotonic() - begun
        verdict = "LIVES" if found is None else f"found by {found}"
        say(f"{number:3} {mutant.path}:{mutant.line}  {mutant.fault}  {verdict} ({seconds:.0f} s)")
    say(f"{len(drawn) - len(lived)} of {len(drawn)} found; rooms {', '.join(options.rooms)}, seed {options.seed}")
    return 0


def draw(rooms: Sequence[str], number: int, seed: int) -> list[Mutant]:
    """Draw mutants, by turns of each room; of a room each place is as likely, and none is drawn twice."""
    drawing = random.Random(seed)
    every = {room: list(_places(room)) for room in rooms}
    for places in every.values():
        drawing.shuffle(places)
    turns = (_mutant(room, *every[room].pop()) for _ in range(number) for room in rooms if every[room])
    return list(itertools.islice(turns, number))


def finder(mutant: Mutant) -> str | None:
    """Return the test that finds a mutant, or how the tests ended without one; None where all of them pass."""
    _, own, above = ROOMS[mutant.room]
    return _failed(mutant, own) or _failed(mutant, above)


def _failed(mutant: Mutant, tests: Sequence[str]) -> str | None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "sitecustomize.py").write_text(_GIVES_MUTANT, encoding="utf-8")
        code = folder / "mutant.bin"
        code.write_bytes(marshal.dumps(compile(mutant.tree, str(_ROOT / mutant.path), "exec")))
        path = os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH", "")]))
        given = {"PYTHONPATH": path, "TACEVO_MUTANT": f"{mutant.module}={code}", "OMP_NUM_THREADS": "1"}
        options = ["-q", "-x", "--no-header", "-p", "no:cacheprovider", "--numprocesses", "2", "--dist", "worksteal"]
        try:
            done = subprocess.run(
                [sys.executable, "-m", "pytest", *options, *tests],
                cwd=_ROOT,
                env={**os.environ, **given},
                capture_output=True,
                text=True,
                timeout=1200,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return "a test that does not end"
    if done.returncode == 0:
        return None
    lines = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return lines[0].split(" - ")[0].partition(" ")[2] if lines else f"pytest, which ends with {done.returncode}"


def _places(room: str) -> Iterator[tuple[Path, int]]:
    """Yield the modules of a room with the numbers of their nodes that a fault could be in."""
    for folder in ROOMS[room][0]:
        for path in sorted((_ROOT / folder).rglob("*.py")):
            if path.name not in _LEFT_OUT:
                nodes = _nodes(ast.parse(path.read_text(encoding="utf-8")))
                yield from ((path, number) for number, node in enumerate(nodes) if _change(node) is not None)


def _mutant(room: str, path: Path, number: int) -> Mutant:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    node = next(itertools.islice(_nodes(tree), number, None))
    change, before = _change(node), ast.unparse(node)
    assert change is not None
    change(node)
    fault = f"{_short(before)} -> {_short(ast.unparse(node))}"
    return Mutant(room, path.relative_to(_ROOT), node.lineno, fault, ast.fix_missing_locations(tree))


def _short(code: str) -> str:
    line = " ".join(code.split())
    return line if len(line) <= 60 else f"{line[:57]}..."


def _nodes(tree: ast.Module) -> Iterator[ast.expr | ast.stmt]:
    """Yield the nodes inside functions that a fault could be in, always in the same order; types are left out."""
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef):
            types = {id(each) for each in _types(function)}
            for statement in function.body:
                for node in ast.walk(statement):
                    if isinstance(node, ast.expr | ast.stmt) and id(node) not in types:
                        yield node


def _types(function: ast.FunctionDef) -> Iterator[ast.AST]:
    for node in ast.walk(function):
        if isinstance(node, ast.AnnAssign):
            yield from ast.walk(node.annotation)
        if isinstance(node, ast.FunctionDef | ast.Raise):  # an inner function has its turn; words of errors are no code
            yield from ast.walk(node) if node is not function else ()


def _change(node: ast.AST) -> Callable[[ast.AST], None] | None:
    """Return what makes a fault of a node, or None."""
    change: Callable[[ast.AST], None] | None = None
    match node:
        case ast.Compare(ops=[op]) if type(op) in _COMPARED:
            change = _compare
        case ast.BinOp(op=op) if type(op) in _COMPUTED and not isinstance(node.left, ast.Constant | ast.JoinedStr):
            change = _compute
        case ast.BoolOp():
            change = _join
        case ast.UnaryOp(op=ast.Not()) | ast.IfExp():
            change = _turn
        case ast.Constant(value=bool() | int() | float()):
            change = _count
        case ast.Expr(value=ast.Call()):
            change = _leave_out
    return change


def _compare(node: ast.AST) -> None:
    assert isinstance(node, ast.Compare)
    node.ops = [_COMPARED[type(node.ops[0])]()]


def _compute(node: ast.AST) -> None:
    assert isinstance(node, ast.BinOp)
    node.op = _COMPUTED[type(node.op)]()


def _join(node: ast.AST) -> None:
    assert isinstance(node, ast.BoolOp)
    node.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()


def _turn(node: ast.AST) -> None:
    """Let `not X` be `not not X`, and take the other branch of a conditional expression."""
    if isinstance(node, ast.IfExp):
        node.body, node.orelse = node.orelse, node.body
    elif isinstance(node, ast.UnaryOp):
        node.operand = ast.UnaryOp(ast.Not(), node.operand)


def _count(node: ast.AST) -> None:
    assert isinstance(node, ast.Constant)
    value = node.value
    node.value = not value if isinstance(value, bool) else value + 1  # type: ignore[operator]  # an int or a float


def _leave_out(node: ast.AST) -> None:
    assert isinstance(node, ast.Expr)
    node.value = ast.Constant(None)


if __name__ == "__main__":
    sys.exit(main())
