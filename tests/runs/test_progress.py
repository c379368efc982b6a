"""Promise: who watches a search reads how many of its slots are done."""

import io
from dataclasses import replace

import fakes
import pytest
from rich.console import Console

from tacevo.evolution.algorithm import run_search
from tacevo.evolution.state import Budget, Plan
from tacevo.records import Training
from tacevo.rounding import significant
from tacevo.runs.progress import Progress, Watcher
from tacevo.storage.ledger import Ledger

PLAN = fakes.plan(generations=2)


@pytest.mark.parametrize(
    ("plan", "told"),
    [
        (PLAN, "(16 of 16 slots done)"),
        (replace(PLAN, reevaluations=2), "(16 of 16 slots done)"),  # some of which trained an elite again
        (replace(PLAN, budget=Budget(flops=1, images=1, epochs=1)), "(4 of at most 16 slots done)"),
    ],
)
def test_slots_are_counted(plan: Plan, told: str) -> None:
    """A budget may end a search before all that were planned."""
    out = io.StringIO()
    run_search(plan, fakes.effects(), Ledger(), Watcher(plan, Progress(Console(file=out))))
    assert told in out.getvalue().splitlines()[-1]


@pytest.mark.parametrize(("trivial", "is_chance"), [(None, False), (0.001, True), (50.0, False)])
def test_best_stands_beside_baseline_and_trivial_loss(trivial: float | None, is_chance: bool) -> None:
    """In the line of every generation, from the first on; of a run that records no trivial loss, the baseline."""
    out = io.StringIO()
    baseline = fakes.evaluate(fakes.TASK.baseline)
    assert isinstance(baseline, Training)
    run_search(PLAN, fakes.effects(), Ledger(), Watcher(PLAN, Progress(Console(file=out)), trivial))
    lines = out.getvalue().splitlines()
    beside = f"baseline {significant(baseline.validation_losses[-1])}" + (
        "" if trivial is None else f", trivial {significant(trivial)}"
    )
    assert len(lines) == 3
    assert [line for line in lines if f"({beside})" not in line or ("at chance" in line) != is_chance] == []
