"""Outputs, which add tables, figures and sections of the page: all that are installed are used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from analysis.report.collection import Collection, Compared
    from analysis.report.figure_list import Picture
    from analysis.report.sweep_collection import SweepCollection
    from analysis.studies.reestimates import Reestimates
    from analysis.table import Table
    from tacevo.profile import Profile
    from tacevo.results.run import RecordedRun


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A section of the page (`tacevo report`): all of it is shown as text, tables and images, and none as markup."""

    title: str
    #: A paragraph each, above all else.
    sentences: Sequence[str] = ()
    figures: Sequence[Picture] = ()
    tables: Sequence[Table] = ()

    def __post_init__(self) -> None:
        """Keep what was given as tuples, and check the texts; raises TypeError."""
        if not isinstance(self.sentences, str):
            for name in ("sentences", "figures", "tables"):
                object.__setattr__(self, name, tuple(getattr(self, name)))
        if not isinstance(self.title, str) or not self.title.strip():
            raise TypeError(f"expected a title of a section; got {self.title!r}")
        if isinstance(self.sentences, str) or not all(isinstance(one, str) for one in self.sentences):
            raise TypeError(f"expected a list of sentences; got {self.sentences!r}")


class Output:
    """The base of outputs: it adds nothing until a method is overridden.

    An output of your own is a class that is made without arguments, named by an entry point of the group
    `tacevo.outputs`. Its tables and figures stand beside ours in what `tacevo tables`, `figures`, `ablations` and
    `report` write, and not in a bundle, which anybody must be able to make again. The name of a table or figure is that
    of its files, so it has letters, digits, `.`, `_` and `-`, and is none of ours.

    What a method raises is told with its line; all else is written.
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

    def reestimate_tables(self, run: Collection, again: Reestimates) -> Sequence[Table]:
        """Make tables of what one study or noise run recorded of the run's fitnesses under other seeds; as above."""
        return ()

    def beside(self, runs: Sequence[RecordedRun]) -> Sequence[Table]:
        """Make tables that set runs, one or more, beside what others published."""
        return ()

    def figures(self, run: Collection) -> Sequence[Picture]:
        """List pictures of a run."""
        return ()

    def section(self, run: Collection) -> Section | None:
        """Make a section of the page of a run; None for none."""
        return None

    def sweep_tables(self, sweep: SweepCollection) -> Sequence[Table]:
        """Make tables of a sweep: with its finished jobs and their runs, its arms, and their comparison."""
        return ()

    def sweep_figures(self, sweep: SweepCollection) -> Sequence[Picture]:
        """List pictures of a sweep."""
        return ()

    def sweep_section(self, sweep: SweepCollection) -> Section | None:
        """Make a section of the page of a sweep; None for none."""
        return None
