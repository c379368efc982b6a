"""Promise: the pages of what was found say and show what the published runs say."""

import csv
import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from checkout import ROOT

from analysis.figures.style import render
from benchmarks.found.pages import table

FOUND = ROOT / "docs/found"

with (FOUND / "figures.csv").open(encoding="utf-8", newline="") as lines:
    ROWS = [*csv.DictReader(lines)]

pytestmark = pytest.mark.timeout(600)


@pytest.fixture(scope="module")
def draw() -> ModuleType:
    """Return the script that draws the pictures."""
    spec = importlib.util.spec_from_file_location("found_draw", FOUND / "draw.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = script
    spec.loader.exec_module(script)
    return script


def test_every_picture_is_that_of_the_bundles(draw: ModuleType) -> None:
    """Drawn again, it has the same bytes; each is on a page, and no page shows another."""
    drawn = {f"{name}.svg": render(picture(), ".svg") for name, picture in draw.PICTURES.items()}
    assert drawn == {path.name: path.read_bytes() for path in FOUND.glob("*.svg")}
    pages = "".join(path.read_text(encoding="utf-8") for path in FOUND.glob("*.md"))
    assert [name for name in drawn if f"]({name})" not in pages] == []


def test_table_of_figures_is_that_of_the_bundles() -> None:
    """Computed again, it has the same bytes."""
    assert table() == (FOUND / "figures.csv").read_bytes()


@pytest.mark.parametrize("page", sorted({row["page"] for row in ROWS}))
def test_every_figure_of_the_table_is_on_its_page(page: str) -> None:
    """As the table prints it: in the picture that it names, else in the text."""
    pictures = {row["picture"] for row in ROWS if row["page"] == page} - {""}
    shown = {name: _words(FOUND / name) for name in pictures} | {"": _words(FOUND / page)}
    assert [row for row in ROWS if row["page"] == page and row["printed"] not in shown[row["picture"]]] == []


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", *sorted(FOUND.glob("*.md"))], ids=lambda page: f"{page.parent.name}/{page.stem}"
)
def test_every_interval_of_an_answer_is_in_the_table(page: Path) -> None:
    """An answer ends where the page says what it does not say; of README it is the list of what was found."""
    text = _words(page)
    if page.parent == ROOT:
        text = text.partition("## What was found")[2].partition(" ## ")[0]
    answer = text.partition("**What this does not say.**")[0]
    said = re.findall(r"-?\d+\.\d+ \[-?\d+\.\d+, -?\d+\.\d+\]", answer)
    assert [one for one in said if one not in {row["printed"] for row in ROWS}] == []


def _words(path: Path) -> str:
    """Return the text of a page or a picture on one line, without the marks of a picture's text."""
    return " ".join(re.sub(r"</?(?:text|tspan)[^>]*>", " ", path.read_text(encoding="utf-8")).split())
