"""The lineage of a network is every network it was made from, once, in the order of the search."""

import numpy as np
import pytest
from hand_runs import closed, run, trained
from refusals import refused

from analysis.runs.lineage import LINEAGE, ancestors, lineage
from analysis.tables.dynamics import lineage_table
from tacevo.errors import RunError
from tacevo.results.run import RecordedRun


def family() -> RecordedRun:
    """Return a run in which two children of the baseline are crossed, and a fourth network stands apart."""
    slots = [
        trained(0, 0, 0.8),
        trained(1, 0, 0.6, prompt=0),
        trained(1, 1, 0.7, prompt=1),
        trained(2, 0, 0.5, prompt=None, parents=("g01s00", "g01s01")),
        trained(2, 1, 0.9, prompt=1, parents=("g01s01",)),
    ]
    return run(slots, [closed(0), closed(1), closed(2)])


def test_ancestors_come_once_and_in_order() -> None:
    """The baseline is an ancestor twice over."""
    assert [candidate.id for candidate in ancestors(family(), "g02s00")] == ["g00s00", "g01s00", "g01s01", "g02s00"]


def test_each_step_says_what_was_asked_and_what_it_brought() -> None:
    """A crossover is measured against the better parent; a network worse than its parent has a negative gain."""
    steps = lineage(family(), "g02s00")
    assert steps.instruction.isna().tolist() == [True, False, False, True]
    assert steps.instruction[1:3].tolist() == ["refine", "widen"]
    assert steps.gain.tolist() == pytest.approx([np.nan, 0.2, 0.1, 0.1], nan_ok=True)
    assert lineage(family(), "g02s01").gain.iloc[-1] == pytest.approx(-0.2)
    assert {name: str(kind) for name, kind in steps.dtypes.items()} == LINEAGE


def test_table_shows_the_steps() -> None:
    """Operator, instruction and parents beside the fitness."""
    rows = lineage_table(family(), "g02s00").rows
    assert rows[0] == ("g00s00", "baseline", None, None, 0.8, None)
    assert rows[3][:5] == ("g02s00", "crossover", None, "g01s00, g01s01", 0.5)


def test_unknown_candidate_is_named() -> None:
    """With the form that ids have."""
    with refused(RunError, got="'best'", expected="the id of a candidate"):
        ancestors(family(), "best")
