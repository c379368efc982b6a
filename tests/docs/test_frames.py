"""Promise: docs/analysis.md has the columns and the types of every frame that docs/python.md leaves to it."""

import re

import pytest
from checkout import ROOT

from analysis.runs import dynamics, lineage
from analysis.studies import comparison, searches
from analysis.sweeps import ablation

FRAMES = {
    "PRODUCTIVITY": dynamics.PRODUCTIVITY,
    "LINEAGE": lineage.LINEAGE,
    "COMPARISONS": comparison.COMPARISONS,
    "CHOSEN": searches.CHOSEN,
    "JOBS": ablation.JOBS,
}


@pytest.mark.parametrize("name", FRAMES)
def test_columns_of_a_frame_are_documented(name: str) -> None:
    """Each with its type, and no other."""
    assert documented(name) == FRAMES[name]


@pytest.mark.room("effects of instructions")
def test_columns_of_the_effects_of_instructions_are_documented() -> None:
    """As those of the others."""
    from analysis.runs.instruction_effects import INSTRUCTIONS

    assert documented("INSTRUCTIONS") == INSTRUCTIONS


def documented(name: str) -> dict[str, str]:
    """Read the columns of a frame, and their types, from the page."""
    text = (ROOT / "docs" / "analysis.md").read_text(encoding="utf-8")
    (cell,) = re.findall(rf"^\| .+ \| .+ \| `{name}` \| (.+) \|$", text, re.MULTILINE)
    return {column: kind.partition(":")[0] for kind in cell.split("; ") for column in re.findall("`(.+?)`", kind)}
