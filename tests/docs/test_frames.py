"""Promise: docs/analysis.md has the columns and the types of every frame that docs/python.md leaves to it."""

import re

import pytest
from checkout import ROOT

from analysis.runs import dynamics, instruction_effects, lineage
from analysis.studies import comparison, searches
from analysis.sweeps import ablation

FRAMES = {
    "PRODUCTIVITY": dynamics.PRODUCTIVITY,
    "INSTRUCTIONS": instruction_effects.INSTRUCTIONS,
    "LINEAGE": lineage.LINEAGE,
    "COMPARISONS": comparison.COMPARISONS,
    "CHOSEN": searches.CHOSEN,
    "JOBS": ablation.JOBS,
}


@pytest.mark.parametrize("name", FRAMES)
def test_columns_of_a_frame_are_documented(name: str) -> None:
    """Each with its type, and no other."""
    text = (ROOT / "docs" / "analysis.md").read_text(encoding="utf-8")
    (cell,) = re.findall(rf"^\| .+ \| .+ \| `{name}` \| (.+) \|$", text, re.MULTILINE)
    documented = {column: kind.partition(":")[0] for kind in cell.split("; ") for column in re.findall("`(.+?)`", kind)}
    assert documented == FRAMES[name]
