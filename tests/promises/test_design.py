"""docs/design.md draws the tree as it is."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


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
