"""What the page shows of a sweep beside its runs, as JSON: the arms, compared."""

from typing import Any

import numpy as np
import pandas as pd

from analysis.report.outputs import Outputs, Say, outputs, unsaid
from analysis.report.page.finding import found_in_sweep
from analysis.report.page.of_run import table_contents
from analysis.report.page.sections import sections_contents
from analysis.report.sweep_collection import SweepCollection, sweep_tables
from analysis.sweeps.ablation import CURVES, QUARTILES, by_generation
from analysis.sweeps.arm_metrics import FRACTIONS, Metric

#: What is shown of every arm at the end, as far as it is known.
ENDS = (
    Metric.test_mse,
    Metric.test_accuracy,
    Metric.test_loss,
    Metric.best_fitness,
    Metric.new_quartile,
    Metric.qd_score,
    Metric.coverage,
)


def sweep_contents(collected: SweepCollection, installed: Outputs | None = None, say: Say = unsaid) -> dict[str, Any]:
    """Return the arms of a sweep: how they went by generation, where every seed ended, the tables, and sections.

    Of installed outputs there are those of ours unless others are given; `say` is called with a sentence on what
    others cannot make.
    """
    known = outputs(ours=True) if installed is None else installed
    arms = [
        {
            "name": name,
            "bands": {metric.value: _band(collected.curves, name, metric) for metric in CURVES},
            "ends": {
                metric.value: list(collected.ablation.values(name, metric).items())
                for metric in ENDS
                if metric in collected.ablation.arms
            },
        }
        for name in collected.ablation.names
        if name in set(collected.ablation.jobs.arm)
    ]
    return {
        "found": found_in_sweep(collected.ablation),
        "arms": arms,
        "tables": [table_contents(table) for table in sweep_tables(collected, known, say)],
        "shares": [metric.value for metric in ENDS if metric in FRACTIONS],
        "sections": sections_contents(known.sweep_sections(collected, say), say),
    }


def _band(curves: pd.DataFrame, arm: str, metric: Metric) -> dict[str, list[float | None]]:
    """Return the quartiles over the seeds of an arm by generation; None where a seed has no value."""
    values = by_generation(curves, arm, metric)
    ends = np.quantile(values, QUARTILES, axis=0)
    rows = ([None if np.isnan(end) else end for end in row] for row in ends.tolist())
    return dict(zip(("low", "median", "high"), rows, strict=True))
