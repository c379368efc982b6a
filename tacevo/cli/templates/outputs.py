"""Outputs: tables, figures and a section of the page, of each run or sweep that is read."""

from collections.abc import Mapping, Sequence

from analysis.report.collection import Collection
from analysis.table import Table
from tacevo.parts.output import Output, Section
from tacevo.profile import Profile


class Mine(Output):
    """Says how many candidates of a run trained."""

    def tables(self, run: Collection, profiles: Mapping[str, Profile] | None) -> Sequence[Table]:
        """Make the tables of a run; a table is a row for each tuple."""
        rows = ((len(run.run.candidates), len(run.run.trained)),)
        return [Table(name="mine", caption="Candidates.", columns=("asked for", "trained"), rows=rows)]

    def section(self, run: Collection) -> Section:
        """Make a section of the page of a run."""
        return Section(title="Candidates that trained", tables=self.tables(run, None))
