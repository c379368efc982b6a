"""Outputs, which add tables and figures of runs and their studies: all that are installed are used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from analysis.report.collection import Collection, Compared
    from analysis.report.figure_list import Picture
    from analysis.report.sweep_collection import SweepCollection
    from analysis.table import Table
    from tacevo.profile import Profile
    from tacevo.results.run import RecordedRun


class Output:
    """What an output adds: nothing, until a method is overridden.

    An output of your own is a class that is made without arguments, named by an entry point of the group
    `tacevo.outputs`. Its tables and figures stand beside ours in what `tacevo tables`, `figures` and `report` write,
    and not in a bundle, which anybody must be able to make again.
    """

    def findings(self, run: RecordedRun, study: Compared) -> tuple[Any, list[str]]:
        """Compute once what a study says, for `study.found[NAME]`, and why something is missing, a sentence each."""
        return None, []

    def tables(self, run: Collection, profiles: Mapping[str, Profile] | None) -> Sequence[Table]:
        """Make tables of a run.

        Args:
            run: with its ledger, archives, niches and finished studies.
            profiles: what the gate traced of each trained candidate, by id; None where the stores are elsewhere.
        """
        return ()

    def study_tables(self, run: Collection, study: Compared) -> Sequence[Table]:
        """Make tables of one study of a run; the name of the study is put before theirs."""
        return ()

    def sweep_tables(self, sweep: SweepCollection) -> Sequence[Table]:
        """Make tables of a sweep, whose arms are compared."""
        return ()

    def beside(self, runs: Sequence[RecordedRun]) -> Sequence[Table]:
        """Make tables that set runs, one or more, beside what others published."""
        return ()

    def figures(self, run: Collection) -> Sequence[Picture]:
        """List pictures of a run."""
        return ()
