"""Whom the elites descend from: a table, and a section of the page, of a run and of a sweep."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from analysis.report.collection import Collection
from analysis.report.sweep_collection import SweepCollection
from analysis.runs.lineage import ancestors
from analysis.table import Percent, Table
from tacevo.parts.output import Output, Section
from tacevo.profile import Profile
from tacevo.results.run import RecordedRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Ancestors(Output):
    """Adds a table and a section of the page: of how many elites each candidate is an ancestor."""

    def tables(self, run: Collection, profiles: Mapping[str, Profile] | None) -> Sequence[Table]:
        """Make the table of a run."""
        return [ancestors_table(run.run)]

    def section(self, run: Collection) -> Section:
        """Make the section of a run, with a figure."""
        from analysis.report.figure_list import Picture  # Matplotlib takes a second to import

        counts = descendants(run.run)
        return Section(
            title="Whom the elites descend from",
            sentences=[
                f"{len(counts)} of {len(run.run.trained)} trained candidates have an elite among their descendants.",
                "Where a few candidates are ancestors of nearly all elites, the search went on from few ideas.",
            ],
            figures=[
                Picture(
                    name="ancestors",
                    caption="Elites that descend from each ancestor, most first.",
                    draw=lambda: _draw(sorted(counts.values(), reverse=True)),
                )
            ],
            tables=[ancestors_table(run.run)],
        )

    def sweep_tables(self, sweep: SweepCollection) -> Sequence[Table]:
        """Make the table of a sweep."""
        return [ancestors_of_jobs(sweep)]

    def sweep_section(self, sweep: SweepCollection) -> Section:
        """Make the section of a sweep."""
        return Section(
            title="Whom the elites descend from, by job",
            sentences=["A rule that draws few parents leaves few candidates among the ancestors of the elites."],
            tables=[ancestors_of_jobs(sweep)],
        )


def descendants(run: RecordedRun) -> Counter[str]:
    """Count of how many elites each candidate is an ancestor, by id; of none where it is not there."""
    elites = [elite.id for elite in run.elites]
    return Counter(one.id for elite in elites for one in ancestors(run, elite) if one.id != elite)


def ancestors_table(run: RecordedRun) -> Table:
    """Show the ancestors of the elites of a run."""
    fitness = run.fitness
    rows = tuple((name, fitness.get(name), count) for name, count in descendants(run).most_common())
    return Table(
        name="ancestors",
        caption=f"Ancestors of the {len(run.elites)} elites of {run.name}.",
        columns=("candidate", "fitness", "elites that descend from it"),
        rows=rows,
    )


def ancestors_of_jobs(sweep: SweepCollection) -> Table:
    """Show how many ancestors the elites of each job have."""
    rows = []
    for one in sweep.sweep.finished:
        count, trained = len(descendants(one.run)), len(one.run.trained)
        rows.append((one.job.name, one.job.arm, len(one.run.elites), count, Percent(count / trained)))
    return Table(
        name="ancestors",
        caption="Ancestors of the elites, by job.",
        columns=("job", "arm", "elites", "ancestors of an elite", "of all that trained"),
        rows=tuple(rows),
    )


def _draw(counts: Sequence[int]) -> "Figure":
    from analysis.figures.style import new_figure

    figure, (axes,) = new_figure("single", 1.8)
    axes.bar(range(1, len(counts) + 1), counts)
    axes.set(xlabel="ancestor", ylabel="elites")
    return figure
