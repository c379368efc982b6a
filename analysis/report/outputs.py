"""The outputs that are installed, ours and others, and what of ours is not."""

import contextlib
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from analysis.report.writing import FURTHER, INDEX, PAPER
from analysis.studies.reestimates import Reestimates
from analysis.table import Table
from analysis.tables.rendering import table_texts
from tacevo.errors import ConfigError, TacevoError
from tacevo.parts.facts import OUTPUT_TABLES
from tacevo.parts.kinds import OUTPUTS
from tacevo.parts.output import Output, Section
from tacevo.parts.registry import Part, missing, parts, raised
from tacevo.parts.registry import ours as our_parts
from tacevo.profile import Profile
from tacevo.results.run import RecordedRun

if TYPE_CHECKING:
    from analysis.report.collection import Collection, Compared
    from analysis.report.figure_list import Picture
    from analysis.report.sweep_collection import SweepCollection

#: Is called with a sentence on what somebody's output could not make.
Say = Callable[[str], object]

T = TypeVar("T")

#: What a table or a figure of somebody's may be called: it is the name of files.
_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,99}")

#: The names of our tables, of which some go on behind `_`, and of the file that lists them; in small letters, since
#: some file systems tell no others apart.
_OURS = tuple(name.casefold() for name in (*PAPER, *FURTHER, INDEX.partition(".")[0]))


def unsaid(sentence: str) -> None:
    """Say nothing, where outputs of ours alone are used: they make all, or raise."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outputs:
    """Outputs that can be used, and why others cannot; methods as of `tacevo.parts.output.Output`.

    What one raises that is not ours is said, and nothing else is lost by it.
    """

    known: tuple[tuple[Part, Output], ...]
    #: By name, a sentence each.
    missing: Mapping[str, str]

    def findings(self, run: RecordedRun, study: "Compared") -> tuple[dict[str, Any], list[str]]:
        """Return what each output found in a study, by its name, and why something is missing."""
        found: dict[str, Any] = {}
        lacking: list[str] = []
        for part, output in self.known:
            with left_out(part, "findings", lacking.append):
                found[part.name], reasons = output.findings(run, study)
                lacking += reasons
        return found, lacking

    def tables(self, run: "Collection", profiles: Mapping[str, Profile] | None, say: Say) -> list[Table]:
        """Make their tables of a run."""
        return self._tables(lambda output: output.tables(run, profiles), say)

    def study_tables(self, run: "Collection", study: "Compared", say: Say) -> list[Table]:
        """Make their tables of a study."""
        return self._tables(lambda output: output.study_tables(run, study), say)

    def reestimate_tables(self, run: "Collection", again: Reestimates, say: Say) -> list[Table]:
        """Make their tables of re-estimates."""
        return self._tables(lambda output: output.reestimate_tables(run, again), say)

    def beside(self, runs: Sequence[RecordedRun], say: Say) -> list[Table]:
        """Make their tables that set runs beside what others published."""
        return self._tables(lambda output: output.beside(runs), say)

    def sweep_tables(self, sweep: "SweepCollection", say: Say) -> list[Table]:
        """Make their tables of a sweep."""
        return self._tables(lambda output: output.sweep_tables(sweep), say)

    def figures(self, run: "Collection", say: Say) -> list[tuple[Part, "Picture"]]:
        """List their pictures of a run, each with its part."""
        return self._figures(lambda output: output.figures(run), say)

    def sweep_figures(self, sweep: "SweepCollection", say: Say) -> list[tuple[Part, "Picture"]]:
        """List their pictures of a sweep, each with its part."""
        return self._figures(lambda output: output.sweep_figures(sweep), say)

    def sections(self, run: "Collection", say: Say) -> list[tuple[Part, Section]]:
        """Make their sections of the page of a run, each with its part."""
        return self._sections(lambda output: output.section(run), say)

    def sweep_sections(self, sweep: "SweepCollection", say: Say) -> list[tuple[Part, Section]]:
        """Make their sections of the page of a sweep, each with its part."""
        return self._sections(lambda output: output.sweep_section(sweep), say)

    def has(self, name: str) -> bool:
        """Answer whether an output of this name can be used."""
        return any(part.name == name for part, _ in self.known)

    def makes(self, kind: str) -> bool:
        """Answer whether tables of this kind can be made: all but those of an output of ours that is missing."""
        return not any(kind in OUTPUT_TABLES.get(name, ()) for name in self.missing)

    def _tables(self, make: Callable[[Output], Sequence[Table]], say: Say) -> list[Table]:
        made, kept = self._made("tables", make, say), list[Table]()
        for part, table in made:
            with left_out(part, f"table {getattr(table, 'name', table)!r}", say):
                _check_is(isinstance(table, Table), table, "an analysis.table.Table")
                if not part.is_ours:
                    _check_name(table.name, {one.name for one in kept})
                    is_ours = table.name.casefold().startswith(tuple(f"{name}_" for name in _OURS))
                    _check_is(not is_ours and table.name.casefold() not in _OURS, table.name, "a name that is not ours")
                    table_texts(table)  # its cells may be what no file can hold
                kept.append(table)
        return kept

    def _figures(self, make: Callable[[Output], Sequence["Picture"]], say: Say) -> list[tuple[Part, "Picture"]]:
        made, kept = self._made("figures", make, say), list[tuple[Part, "Picture"]]()
        for part, picture in made:
            with left_out(part, f"figure {getattr(picture, 'name', picture)!r}", say):
                is_one = callable(getattr(picture, "draw", None))  # whose class takes a second to import
                _check_is(is_one, picture, "an analysis.report.figure_list.Picture")
                _check_name(picture.name, {one.name for _, one in kept})
                kept.append((part, picture))
        return kept

    def _sections(self, make: Callable[[Output], Section | None], say: Say) -> list[tuple[Part, Section]]:
        def made(output: Output) -> list[Section]:
            section = make(output)
            _check_is(section is None or isinstance(section, Section), section, "a Section, or None")
            return [] if section is None else [section]

        return self._made("section", made, say)

    def _made(self, what: str, make: Callable[[Output], Sequence[T]], say: Say) -> list[tuple[Part, T]]:
        """Have each output make something, and leave out what one raises that is not ours."""
        made: list[tuple[Part, T]] = []
        for part, output in self.known:
            with left_out(part, what, say):
                found = make(output)
                _check_is(isinstance(found, Iterable) and not isinstance(found, str), found, f"a list of {what}")
                made += [(part, one) for one in found]
        return made


def _check_is(holds: bool, made: object, expected: str) -> None:
    """Raise a ConfigError where an output made something else than is expected."""
    if not holds:
        raise ConfigError(repr(made), place="what it returns", expected=expected)


def _check_name(name: str, taken: Set[str]) -> None:
    """Raise a ConfigError where this cannot be the name of files of a table or a figure of somebody's."""
    if not _NAME.fullmatch(name) or name.casefold() in {one.casefold() for one in taken}:
        expected = "a name of letters, digits, '.', '_' and '-', which no other has"
        raise ConfigError(repr(name), place="name", expected=expected)


@contextlib.contextmanager
def left_out(part: Part, what: str, say: Say) -> Iterator[None]:
    """Say what code of somebody's raised, in which line, and go on without what it was to make.

    Args:
        part: whose code it is; what one of ours raises is raised.
        what: it was to make, e.g. `tables`.
        say: is called with the sentence.
    """
    try:
        yield
    except (Exception, SystemExit) as error:
        if part.is_ours:
            raise
        say(f"no {what} of {part.name}: {_told(part, error)}")


def _told(part: Part, error: BaseException) -> str:
    if isinstance(error, TacevoError):
        return str(error)
    if isinstance(error, ModuleNotFoundError):
        return str(missing(error))
    file = getattr(sys.modules.get(part.module), "__file__", None)
    return raised(error, Path(file) if file else None)


@cache
def outputs(*, ours: bool = False) -> Outputs:
    """Import the outputs that are installed, or ours alone."""
    known: list[tuple[Part, Output]] = []
    lacking: dict[str, str] = {}
    for part in our_parts(OUTPUTS) if ours else parts(OUTPUTS):
        said: list[str] = []
        try:
            with left_out(part, "tables or figures", said.append):
                known.append((part, _instance(part)))
        except ConfigError as error:
            said.append(f"no tables or figures of {part.name}: {error}")
        if said:
            lacking[part.name] = said[0]
    return Outputs(known=tuple(known), missing=lacking)


def _instance(part: Part) -> Output:
    """Import an output, and make it."""
    made = part.load()()
    if not isinstance(made, Output):
        expected = "a class that extends tacevo.parts.output.Output"
        raise ConfigError(repr(made), place=part.place, expected=expected)
    return made
