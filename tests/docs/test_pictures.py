"""Promise: a picture of README or of a page is what its script draws of what was measured and recorded."""

import runpy

import pytest
from checkout import ROOT

from analysis.figures.style import render

SITE, FIGURES = ROOT / "docs/site", ROOT / "docs/figures"

pytestmark = [pytest.mark.room("figures"), pytest.mark.timeout(600)]


def shown() -> set[str]:
    """Return the names of the pictures that README and the pages show."""
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    return {
        path.name for path in FIGURES.iterdir() if any(f"figures/{path.name})" in page.read_text() for page in pages)
    }


def test_every_picture_is_shown() -> None:
    """One that no page shows is nobody's, and would be drawn for ever."""
    assert shown() == {path.name for path in FIGURES.iterdir()}


@pytest.mark.parametrize("script", ["diagrams", "difficulty", "loop", "pictures"])
def test_pictures_are_what_their_script_draws(script: str) -> None:
    """Drawn again they have the same bytes; `make pictures` writes them."""
    names = runpy.run_path(str(SITE / f"{script}.py"))
    pictures = names.get("PICTURES") or {script: names[script]}
    drawn = {f"{name}.svg": render(draw(), ".svg") for name, draw in pictures.items()}
    assert [name for name, data in drawn.items() if data != (FIGURES / name).read_bytes()] == []
