"""The table of alarms: what may be wrong with a run."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.rounding import shown
from analysis.runs.health import alarms
from analysis.table import Table
from tacevo.parts.output import Output
from tacevo.profile import Profile
from tacevo.results.run import RecordedRun

if TYPE_CHECKING:
    from analysis.report.collection import Collection


class Alarms(Output):
    """Adds the alarms of a run, each with the figures behind it."""

    def tables(self, run: "Collection", profiles: Mapping[str, Profile] | None) -> Sequence[Table]:
        """Make the table."""
        return (health_table(run.run, run.niches.networks),)


def health_table(run: RecordedRun, centroids: NDArray[np.float64]) -> Table:
    """Show every alarm of a run; see `analysis.runs.health.alarms`."""
    raised = alarms(run, centroids)
    return Table(
        name="health",
        caption=f"What may be wrong with {run.name}.",
        columns=("alarm", "finding", "figures"),
        rows=tuple(
            (alarm.name, alarm.sentence, ", ".join(f"{name}: {shown(value)}" for name, value in alarm.figures.items()))
            for alarm in raised
        ),
        notes=() if raised else ("No alarm.",),
    )
