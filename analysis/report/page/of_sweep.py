"""What the page shows of a sweep beside its runs: the arms, compared."""

from collections.abc import Mapping, Sequence

import numpy as np

from analysis.report.page.contents import ArmContents, Band, SweepContents
from analysis.report.page.of_run import table_contents
from analysis.report.sweep_collection import SweepCollection, sweep_tables
from analysis.sweeps.ablation import Outcome
from analysis.sweeps.metrics import Metric

#: What is shown of every arm at the end, as far as it is known.
ENDS = (Metric.test_mse, Metric.test_accuracy, Metric.best_fitness, Metric.qd_score, Metric.coverage)


def sweep_contents(found: SweepCollection) -> SweepContents:
    """Return the arms of a sweep: how they went by generation, where every seed ended, and the tables."""
    return SweepContents(
        arms=tuple(
            ArmContents(
                name=arm.name,
                bands=_bands([one for one in found.found.outcomes if one.arm == arm.name]),
                ends={
                    metric.value: tuple(arm.metrics[metric].values.items())
                    for metric in ENDS
                    if metric in found.found.metrics
                },
            )
            for arm in found.found.arms
            if arm.seeds
        ),
        tables=tuple(map(table_contents, sweep_tables(found))),
    )


def _bands(outcomes: Sequence[Outcome]) -> Mapping[str, Band]:
    """Return the quartiles over the seeds of an arm; niches are those of the common archive."""
    return {
        Metric.best_fitness.value: _band([one.best for one in outcomes]),
        Metric.qd_score.value: _band([[after.qd_score for after in one.filled] for one in outcomes]),
        Metric.coverage.value: _band([[after.coverage for after in one.filled] for one in outcomes]),
    }


def _band(rows: Sequence[Sequence[float | None]]) -> Band:
    """Return the quartiles of each column; None where a seed has no value."""
    found = [
        (None,) * 3 if None in column else np.quantile(np.array(column, dtype=np.float64), [0.25, 0.5, 0.75]).tolist()
        for column in zip(*rows, strict=True)
    ]
    low, median, high = (tuple(column) for column in zip(*found, strict=True))
    return Band(low=low, median=median, high=high)
