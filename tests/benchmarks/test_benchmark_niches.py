"""Promise: the benchmark of niches counts what its table says, and docs/descriptors.md holds what it prints."""

import pytest
from checkout import BUNDLES, ROOT

from benchmarks.niches import filled, rows
from tacevo.bundles.open import opened
from tacevo.evolution.archive import Bounds, Tessellation
from tacevo.results.run import read_run

FORCE = BUNDLES / "force-grammar.zip"

#: Four niches in a row, of width 0.25 along the second axis.
ROW = Tessellation([(0.5, 0.125), (0.5, 0.375), (0.5, 0.625), (0.5, 0.875)])
POINTS = [(0.5, 0.0), (0.5, 2.0), (0.5, 4.0), (0.5, 48.0)]
FITNESSES = [0.4, 0.3, 0.2, 0.1]


def test_moving_bounds_lose_niches() -> None:
    """Under bounds 0 to 4 three niches are filled; the last candidate stretches them, and three share the first one."""
    found = filled(POINTS, FITNESSES, ROW, None)
    assert (found.coverage, found.highest, found.lost) == (0.5, 0.75, 1)
    assert found.effective == pytest.approx(4 / 27**0.25)
    assert found.fullest == 0.75


def test_fixed_bounds_lose_none() -> None:
    """Under the bounds that adaptive ones end with, the same niches are filled in the end, and none was lost."""
    fixed = filled(POINTS, FITNESSES, ROW, Bounds(low=(0.5, 0.0), high=(0.5, 48.0)))
    adaptive = filled(POINTS, FITNESSES, ROW, None)
    assert (fixed.coverage, fixed.highest, fixed.lost) == (0.5, 0.5, 0)
    assert (fixed.effective, fixed.fullest) == (adaptive.effective, adaptive.fullest)


def test_documented_figures_are_what_the_command_prints() -> None:
    """The rows of the shipped force run that adapt are documented, and the linear one is the run's own archive."""
    adaptive = [row for row in rows([FORCE]) if "| adaptive |" in row]
    documented = (ROOT / "docs" / "descriptors.md").read_text(encoding="utf-8")
    assert len(adaptive) == 2
    assert [row for row in adaptive if row not in documented] == []
    source = opened(FORCE)
    recorded = read_run(source.folder).generations
    cells = [cell.strip() for cell in adaptive[0].split("|")]
    assert cells[4:6] == [f"{part:.0%}" for part in (recorded[-1].coverage, max(line.coverage for line in recorded))]
