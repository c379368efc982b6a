"""docs/design.md draws the tree as it is, and what a reader starts with needs little of it."""

import json
import re
import subprocess
import sys
import tomllib

import grimp
import pytest
from checkout import ROOT
from rooms import ROOMS


def drawn(start: str) -> list[str]:
    """Read the picture that begins with a row: what stands left of each row's explanation, top to bottom.

    A line that begins with blanks goes on with the one above it.
    """
    text = (ROOT / "docs" / "design.md").read_text(encoding="utf-8")
    picture = text[text.index(f"\n{start} ") + 1 :].split("\n```")[0]
    rows = re.sub(r"\n +", " ", picture).splitlines()
    return [re.split(r"\s{2,}", row.strip())[0] for row in rows]


@pytest.mark.parametrize(("package", "top"), [("tacevo", "cli"), ("analysis", "report")])
def test_picture_of_the_house_is_the_contract(package: str, top: str) -> None:
    """Every package stands in the row that import-linter holds it to, and in no other."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    (contract,) = (kept for kept in contracts if kept["type"] == "layers" and kept["containers"] == [package])
    assert drawn(top) == contract["layers"]


def test_drawn_house_has_the_rooms_of_the_contract() -> None:
    """`python docs/site/house.py` draws it anew, where a room has come or gone."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    (layers,) = (
        kept["layers"] for kept in project["tool"]["importlinter"]["contracts"] if kept.get("containers") == ["tacevo"]
    )
    drawn_rooms = re.findall(r">([a-z]+)</text>", (ROOT / "docs/figures/house.svg").read_text(encoding="utf-8"))
    assert sorted(drawn_rooms) == sorted(re.findall(r"\w+", " ".join(layers[:-1])))


def test_way_of_a_candidate_is_that_of_the_picture() -> None:
    """The page has a row for each red number, with the same room, words and file; the file lies in the room."""
    asked = "import house, json; print(json.dumps(house.WAY))"
    way = json.loads(subprocess.check_output([sys.executable, "-c", asked], cwd=ROOT / "docs/site", text=True))
    text = (ROOT / "docs" / "design.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \| `(\w+)` \| (.+) \| `(.+)` \|$", text, re.MULTILINE)
    assert rows == [(str(number), *step) for number, step in enumerate(way, start=1)]
    assert [file for _, room, _, file in rows if not (ROOT / file).is_file() or f"tacevo/{room}/" not in file] == []


def test_core_and_parts_are_as_the_page_says() -> None:
    """Each room that is hidden in the test has its row, with the modules that are; and all that is named is there."""
    text = (ROOT / "docs" / "design.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (.+?) \| .+? \| (.+?) \| [\d,]+ \| yes \|$", text, re.MULTILINE)
    named = {room: set(re.findall("`(.+?)`", where)) for room, where in rows}
    ours = {
        room: {name for name in names.split() if name.startswith(("tacevo.", "analysis."))}
        for room, names in ROOMS.items()
    }
    assert named == ours
    subprocess.run(
        [sys.executable, "-c", "import costs; costs.counted(costs.PAGE.read_text())"],
        cwd=ROOT / "docs/site",
        check=True,
    )


@pytest.mark.parametrize(("module", "most"), [("tacevo.evolution.algorithm", 20), ("tacevo.results.sweep_jobs", 39)])
def test_module_is_read_with_few_others(module: str, most: int) -> None:
    """What it imports, and what that imports, imports for types included, stays as small as it is."""
    graph = grimp.build_graph("tacevo", cache_dir=None)
    assert len(graph.find_upstream_modules(module)) <= most
