"""Promise: the pages of what was found say and show what the published runs say."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest
from checkout import ROOT

from analysis.figures.style import render

FOUND = ROOT / "docs/found"

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


@pytest.mark.parametrize("page", ["records", "ends", "telling", "operator"])
def test_page_says_the_ratio_of_its_row(page: str, draw: ModuleType) -> None:
    """The ratio and its interval that the answer of a page states are those of the picture of all questions."""
    starts = {"records": "1.", "ends": "    one chosen", "telling": "6.", "operator": "7."}
    (row,) = (row for row in draw.summary_rows() if row.of.startswith(starts[page]))
    text = " ".join(Path(FOUND / f"{page}.md").read_text(encoding="utf-8").split())
    answer = text[: text.index("**What this does not say.**")]
    assert str(row) in answer
