"""docs/design.md draws the tree as it is, and what a reader starts with needs little of it."""

import ast
import re
import tomllib
from pathlib import Path

import grimp
import pytest
from checkout import ROOT
from rooms import ROOMS


def drawn(start: str) -> list[str]:
    """Read the picture that begins with a row: what stands left of each row's explanation, top to bottom."""
    text = (ROOT / "docs" / "design.md").read_text(encoding="utf-8")
    rows = text[text.index(f"    {start} ") :].split("\n\n")[0].splitlines()
    return [re.split(r"\s{2,}", row.strip())[0] for row in rows]


@pytest.mark.parametrize(("package", "top"), [("tacevo", "cli"), ("analysis", "report")])
def test_picture_of_the_house_is_the_contract(package: str, top: str) -> None:
    """Every package stands in the row that import-linter holds it to, and in no other."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    (contract,) = (kept for kept in contracts if kept["type"] == "layers" and kept["containers"] == [package])
    assert drawn(top) == contract["layers"]


def lines_of(where: str) -> int:
    """Count the lines of the files, and of the directories' modules, that a cell of the table of costs names."""
    patterns = [f"{name}**/*.py" if name.endswith("/") else name for name in re.findall("`(.+?)`", where)]
    package = ROOT / "tacevo"  # first: a checkout in which a sweep ran has a directory sweeps/, too
    matches = {pattern: list(package.glob(pattern)) or list(ROOT.glob(pattern)) for pattern in patterns}
    assert [pattern for pattern, files in matches.items() if not files] == []
    files = [file for files in matches.values() for file in files]
    return sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files)


def test_drawn_house_has_the_rooms_of_the_contract() -> None:
    """`python docs/site/house.py` draws it anew, where a room has come or gone."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    (layers,) = (
        kept["layers"] for kept in project["tool"]["importlinter"]["contracts"] if kept.get("containers") == ["tacevo"]
    )
    drawn_rooms = re.findall(r">([a-z]+)</text>", (ROOT / "docs/figures/house.svg").read_text(encoding="utf-8"))
    assert sorted(drawn_rooms) == sorted(re.findall(r"\w+", " ".join(layers[:-1])))


def test_promises_cost_what_the_page_says() -> None:
    """Each row of the table of costs is within 5 % of the lines that its files have."""
    text = (ROOT / "docs" / "design.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| .+? \| (.+?) \| ([\d,]+) \|$", text, re.MULTILINE)
    counted = {where: lines_of(where.partition(" without ")[0]) for where, _ in rows}
    counted |= {where: lines - lines_of(where.partition(" without ")[2]) for where, lines in counted.items()}
    assert rows
    assert counted == pytest.approx({where: int(lines.replace(",", "")) for where, lines in rows}, rel=0.05)


def statements(names: str) -> int:
    """Count the statements of modules and packages, without docstrings; libraries among them have none here."""
    files: set[Path] = set()
    for name in names.split():
        path = ROOT / name.replace(".", "/")
        files |= set(path.rglob("*.py")) | {file for file in [path.with_suffix(".py")] if file.exists()}
    nodes = (node for file in files for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
    return sum(isinstance(node, ast.stmt) and not _is_text(node) for node in nodes)


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def test_core_and_parts_are_as_the_page_says() -> None:
    """Each room that is hidden in the test has its row, and within 5 % (or 5) as many statements; the core the rest."""
    text = (ROOT / "docs" / "design.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (.+?) \| .+? \| .+? \| ([\d,]+) \| (yes|no|-) \|$", text, re.MULTILINE)
    told = {room: int(count.replace(",", "")) for room, count, _ in rows}
    hidden = {room: statements(names) for room, names in ROOMS.items()}
    assert {room for room, _, is_hidden in rows if is_hidden == "yes"} == ROOMS.keys()
    whole = statements("tacevo analysis") - statements(" ".join(ROOMS.values()))
    assert {room: told[room] for room in ("core", *ROOMS)} == pytest.approx(hidden | {"core": whole}, rel=0.05, abs=5)


@pytest.mark.parametrize(("module", "most"), [("tacevo.evolution.algorithm", 20), ("tacevo.results.sweep_jobs", 38)])
def test_module_is_read_with_few_others(module: str, most: int) -> None:
    """What it imports, and what that imports, imports for types included, stays as small as it is."""
    graph = grimp.build_graph("tacevo", cache_dir=None)
    assert len(graph.find_upstream_modules(module)) <= most
