"""The table of alarms: what may be wrong with a run."""

import numpy as np
from numpy.typing import NDArray

from analysis.health import alarms
from analysis.loading import Run
from analysis.rounding import shown
from analysis.tables import Table


def health_table(run: Run, centroids: NDArray[np.float64]) -> Table:
    """Show every alarm of a run; see `analysis.health.alarms`."""
    found = alarms(run, centroids)
    return Table(
        name=f"health_{run.task}",
        caption=f"What may be wrong with {run.name}.",
        columns=("alarm", "finding", "figures"),
        rows=tuple(
            (alarm.name, alarm.sentence, ", ".join(f"{name}: {shown(value)}" for name, value in alarm.figures))
            for alarm in found
        ),
        notes=() if found else ("No alarm.",),
    )
