"""The outputs that are installed, ours and others, and what of ours is not."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from analysis.table import Table
from tacevo.errors import ConfigError, TacevoError
from tacevo.parts.facts import OUTPUT_TABLES
from tacevo.parts.kinds import OUTPUTS
from tacevo.parts.output import Output
from tacevo.parts.registry import Part, parts
from tacevo.parts.registry import ours as our_parts
from tacevo.profile import Profile
from tacevo.results.run import RecordedRun

if TYPE_CHECKING:
    from analysis.report.collection import Collection, Compared
    from analysis.report.figure_list import Picture
    from analysis.report.sweep_collection import SweepCollection


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outputs:
    """Outputs that can be used, and why others cannot; methods as of `tacevo.parts.output.Output`.

    What one raises that is not ours becomes a ConfigError that names it.
    """

    known: tuple[tuple[Part, Output], ...]
    #: By name, a sentence each.
    missing: Mapping[str, str]

    def findings(self, run: RecordedRun, study: "Compared") -> tuple[dict[str, Any], list[str]]:
        """Return what each output found in a study, by its name, and why something is missing."""
        found, lacking = {}, []
        for part, output in self.known:
            with _blaming(part):
                found[part.name], reasons = output.findings(run, study)
            lacking += reasons
        return found, lacking

    def tables(self, run: "Collection", profiles: Mapping[str, Profile] | None) -> Iterator[Table]:
        """Make their tables of a run."""
        for part, output in self.known:
            with _blaming(part):
                yield from output.tables(run, profiles)

    def study_tables(self, run: "Collection", study: "Compared") -> Iterator[Table]:
        """Make their tables of a study."""
        for part, output in self.known:
            with _blaming(part):
                yield from output.study_tables(run, study)

    def sweep_tables(self, sweep: "SweepCollection") -> Iterator[Table]:
        """Make their tables of a sweep."""
        for part, output in self.known:
            with _blaming(part):
                yield from output.sweep_tables(sweep)

    def beside(self, runs: Sequence[RecordedRun]) -> Iterator[Table]:
        """Make their tables that set runs beside what others published."""
        for part, output in self.known:
            with _blaming(part):
                yield from output.beside(runs)

    def figures(self, run: "Collection") -> Iterator["Picture"]:
        """List their pictures of a run."""
        for part, output in self.known:
            with _blaming(part):
                yield from output.figures(run)

    def has(self, name: str) -> bool:
        """Answer whether an output of this name can be used."""
        return any(part.name == name for part, _ in self.known)

    def makes(self, kind: str) -> bool:
        """Answer whether tables of this kind can be made: all but those of an output of ours that is missing."""
        return not any(kind in OUTPUT_TABLES.get(name, ()) for name in self.missing)


@contextlib.contextmanager
def _blaming(part: Part) -> Iterator[None]:
    """Name an output that is not ours beside what it raises."""
    try:
        yield
    except TacevoError:
        raise
    except Exception as error:
        if part.is_ours:
            raise
        expected = f"tables and figures by {part.origin}"
        raise ConfigError(f"{type(error).__name__}: {error}", place=part.place, expected=expected) from error


@cache
def outputs(*, ours: bool = False) -> Outputs:
    """Import the outputs that are installed, or ours alone."""
    known: list[tuple[Part, Output]] = []
    missing: dict[str, str] = {}
    for part in our_parts(OUTPUTS) if ours else parts(OUTPUTS):
        try:
            with _blaming(part):
                known.append((part, part.load()()))
        except ConfigError as error:
            missing[part.name] = f"no tables or figures of {part.name}: {error}"
    return Outputs(known=tuple(known), missing=missing)
