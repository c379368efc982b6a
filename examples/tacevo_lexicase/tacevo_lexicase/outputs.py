"""A table of whom the elites descend from."""

from collections import Counter
from collections.abc import Mapping, Sequence

from analysis.report.collection import Collection
from analysis.runs.lineage import ancestors
from analysis.table import Table
from tacevo.parts.output import Output
from tacevo.profile import Profile


class Ancestors(Output):
    """Adds a table: of how many elites each candidate is an ancestor."""

    def tables(self, run: Collection, profiles: Mapping[str, Profile] | None) -> Sequence[Table]:
        """Make it."""
        elites = [elite.id for elite in run.run.elites]
        counts = Counter(one.id for elite in elites for one in ancestors(run.run, elite) if one.id != elite)
        fitness = run.run.fitness
        rows = tuple((name, fitness.get(name), count) for name, count in counts.most_common())
        return [
            Table(
                name="ancestors",
                caption=f"Ancestors of the {len(elites)} elites of {run.run.name}.",
                columns=("candidate", "fitness", "elites that descend from it"),
                rows=rows,
            )
        ]
