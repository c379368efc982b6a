"""What accuracy costs, as an output: the table of the front in loss and FLOPs, and the figure of it."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

from analysis.runs.dynamics import progress
from analysis.runs.pareto import beside_costs, on_front, with_hypervolumes
from analysis.studies.reestimates import losses_by_source
from analysis.table import Table
from analysis.tables.pareto import pareto_table
from tacevo.parts.output import Output
from tacevo.profile import Profile

if TYPE_CHECKING:
    from analysis.report.collection import Collection
    from analysis.report.figure_list import Picture

_WORDS = (
    "Left: loss and FLOPs of every trained candidate; the line is the front of those that no other one beats "
    "in both. Right: the part of the box between (0, 0) and the reference point that they dominate, by what "
    "the search knew; the point is the baseline's loss and the most FLOPs of any trained candidate"
)


class Pareto(Output):
    """Adds the front in loss and FLOPs, and the hypervolume."""

    def tables(self, run: "Collection", profiles: Mapping[str, Profile] | None) -> Sequence[Table]:
        """Make the table; none where re-estimates that were made cannot be read: the front would be another one."""
        return () if run.unread else (pareto_table(run.run, losses_by_source(run.reestimates)),)

    def figures(self, run: "Collection") -> Sequence["Picture"]:
        """List the figure; none of a run without elites, or without its re-estimates."""
        from analysis.figures.pareto import pareto  # Matplotlib takes a second to import
        from analysis.report.figure_list import Picture

        recorded = run.run
        if run.unread or not recorded.elites:
            return ()
        candidates = beside_costs(recorded, losses_by_source(run.reestimates))
        front, generations = (
            on_front(candidates, ["fitness", "flops"]),
            with_hypervolumes(recorded, progress(recorded)),
        )
        draw = partial(pareto, candidates, front, recorded.baseline.id, generations)
        return (Picture(name="pareto", caption=f"{_WORDS} ({recorded.name}).", draw=draw),)
