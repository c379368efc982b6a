"""docs/design.md describes the tree as it is."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parent.parent


def told_layers() -> list[set[str]]:
    """Read the table of layers, top to bottom: modules of one layer stand side by side, layers apart by `>`."""
    section = (ROOT / "docs" / "design.md").read_text(encoding="utf-8").split("## Layers")[1].split("\n## ")[0]
    rows = [line.split("|") for line in section.splitlines() if line.startswith("|")][2:]
    return [set(re.findall(r"`(\w+)`", layer)) for row in rows for layer in row[2].split(">")]


def test_table_of_layers_is_the_contract() -> None:
    """Every module stands in the layer that import-linter holds it to, and in no other."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    (contract,) = (kept for kept in contracts if kept["type"] == "layers" and kept["containers"] == ["tacevo"])
    assert told_layers() == [set(re.findall(r"\w+", layer)) for layer in contract["layers"]]
