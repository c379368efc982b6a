"""`tacevo replay RUN --diff OTHER`: where two recorded runs part, and how far they agree beyond that.

Nothing is run again: both ledgers are read, checked line by line, and compared. What agrees is said to
agree (tier C of docs/determinism.md); only ledgers without any difference are called equal.
"""

import json
import statistics
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from tacevo.choices import ArchiveKind
from tacevo.evolution.files import Line, RunLine
from tacevo.evolution.lines import CandidateLine, GenerationLine
from tacevo.records import Json
from tacevo.results.run import read_run
from tacevo.storage.canonical import differences, shown, value_at
from tacevo.storage.ledger import first_difference, place_of
from tacevo.text import counted

#: Settings that say where a run lies, and nothing about the run.
_PLACES = {"run.dir", "store.root"}

#: What is shown of a run's end.
_FIGURES = ("best", "coverage", "qd_score")


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """A finished run as it is compared."""

    #: As in run.json.
    config: dict[str, Json]
    #: Whether its network archive has niches.
    has_niches: bool
    lines: tuple[Line, ...]
    #: Hashes of the elites' sources, by niche of the final network archive.
    elites: Mapping[int, str | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Divergence:
    """A field in which two runs differ."""

    #: E.g. `generation 2, slot 3`, or a setting's group.
    place: str
    field: str
    #: Both values as JSON, shortened.
    values: tuple[str, str]

    def __str__(self) -> str:
        one, other = self.values
        return f"{self.place}: field {self.field!r} is {one} in the first run and {other} in the second"


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """How the fitness of equal sources compares in two runs."""

    #: Distinct sources that both runs trained.
    shared: int
    #: Those of them with the same fitness to the last bit.
    same: int
    #: Largest and median absolute difference of fitness; 0 where nothing is shared.
    largest: float
    median: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Overlap:
    """What two final archives have in common."""

    #: Elites of each.
    elites: tuple[int, int]
    #: Sources that are elites of both.
    sources: int
    #: Niches that both fill, and those of them with one source; None if the niches differ, or a run has none.
    niches: tuple[int, int] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Two runs, compared."""

    #: Ledger lines of each.
    lines: tuple[int, int]
    #: Leading lines that are equal.
    equal: int
    #: The first difference; None where one ledger is the beginning of the other.
    divergence: Divergence | None
    #: The first difference behind the header, where the headers differ already.
    decision: Divergence | None
    #: Settings that differ.
    settings: tuple[Divergence, ...]
    agreement: Agreement
    overlap: Overlap
    #: The figures of each one's last generation.
    ends: tuple[Mapping[str, float | None], Mapping[str, float | None]]

    @property
    def is_equal(self) -> bool:
        """Whether the ledgers are the same."""
        return self.divergence is None and self.lines[0] == self.lines[1]


def read_compared(path: Path) -> Compared:
    """Read a finished run to be compared.

    Raises:
        RunError: it is not finished, or something of it was damaged or edited.
    """
    run = read_run(path)
    sources = {line.id: line.source for line in run.candidates}
    return Compared(
        config=run.record.config,
        has_niches=run.config.archive.kind is not ArchiveKind.best,
        lines=run.ledger.lines,
        elites={elite.niche: sources[elite.id] for elite in run.elites},
    )


def compare(one: Compared, other: Compared) -> Comparison:
    """Compare two runs."""
    pairs = list(zip(one.lines, other.lines, strict=False))
    places = (place for place, pair in enumerate(pairs) if pair[0] != pair[1])
    first, second = next(places, None), next(places, None)
    header_differs = first == 0
    return Comparison(
        lines=(len(one.lines), len(other.lines)),
        equal=len(pairs) if first is None else first,
        divergence=None if first is None else _divergence(*pairs[first]),
        decision=_divergence(*pairs[second]) if header_differs and second is not None else None,
        settings=tuple(_settings(one.config, other.config)),
        agreement=agreement(fitness_by_source(one.lines), fitness_by_source(other.lines)),
        overlap=_overlap(one, other),
        ends=(_end(one), _end(other)),
    )


def fitness_by_source(lines: Iterable[Line]) -> dict[str, float]:
    """Return the fitness of every trained source by its hash."""
    candidates = [line for line in lines if isinstance(line, CandidateLine)]
    return {line.source: line.fitness for line in candidates if line.source and line.fitness is not None}


def agreement(one: Mapping[str, float], other: Mapping[str, float]) -> Agreement:
    """Compare the fitness of the sources that two runs share."""
    shared = sorted(one.keys() & other.keys())
    apart = [abs(one[source] - other[source]) for source in shared]
    return Agreement(
        shared=len(shared),
        same=sum(difference == 0 for difference in apart),
        largest=max(apart, default=0.0),
        median=statistics.median(apart) if apart else 0.0,
    )


def describe(found: Comparison) -> str:
    """Say what was found, for a person."""
    return "\n".join(
        [
            *_parting(found),
            *(f"setting {setting.field}: {setting.values[0]} and {setting.values[1]}" for setting in found.settings),
            *_agreeing(found.agreement),
            *_ends(found),
        ]
    )


def _parting(found: Comparison) -> list[str]:
    if found.is_equal:
        return [f"the ledgers are equal: {counted(found.lines[0], 'line')}"]
    lines = [f"equal: the first {counted(found.equal, 'line')}, of {found.lines[0]} and {found.lines[1]}"]
    if found.divergence is None:
        longer = "second" if found.lines[1] > found.lines[0] else "first"
        return [*lines, f"the {longer} run goes on where the other ends"]
    lines.append(f"first difference: {found.divergence}")
    return [*lines, *([] if found.decision is None else [f"first difference behind the header: {found.decision}"])]


def _agreeing(found: Agreement) -> list[str]:
    if not found.shared:
        return ["no source was trained in both runs"]
    return [
        f"{counted(found.shared, 'source')} trained in both: {found.same} with the same fitness; differences up to "
        f"{found.largest:.3g}, median {found.median:.3g}"
    ]


def _ends(found: Comparison) -> list[str]:
    overlap, (one, other) = found.overlap, found.ends
    shared = f"elites: {overlap.elites[0]} and {overlap.elites[1]}; {overlap.sources} sources are elites of both"
    if overlap.niches is None:
        shared += "; niches are not compared: the runs have different ones, or none"
    else:
        shared += f"; {overlap.niches[0]} niches are filled in both, {overlap.niches[1]} of them by one source"
    return [
        *(f"{name.replace('_', ' ')}: {one[name]} and {other[name]}" for name in _FIGURES),
        shared,
    ]


def _divergence(one: object, other: object) -> Divergence:
    field, values = first_difference(one, other)
    return Divergence(place=place_of(one), field=field, values=values)


def _settings(one: dict[str, Json], other: dict[str, Json]) -> Iterable[Divergence]:
    for field in differences(one, other):
        if shown(field) not in _PLACES:
            values = (json.dumps(value_at(one, field)), json.dumps(value_at(other, field)))
            yield Divergence(place=str(field[0]), field=shown(field), values=values)


def _end(run: Compared) -> dict[str, float | None]:
    """Return the figures of a run's last generation."""
    last = [line for line in run.lines if isinstance(line, GenerationLine)][-1]
    return {name: getattr(last, name) for name in _FIGURES}


def _overlap(one: Compared, other: Compared) -> Overlap:
    first, second = one.elites, other.elites
    both = first.keys() & second.keys()
    centroids = [{line.centroids for line in run.lines if isinstance(line, RunLine)} for run in (one, other)]
    # Places of an archive without niches mean nothing in another.
    alike = one.has_niches and other.has_niches and centroids[0] == centroids[1]
    return Overlap(
        elites=(len(first), len(second)),
        sources=len(set(first.values()) & set(second.values())),
        niches=(len(both), sum(first[niche] == second[niche] for niche in both)) if alike else None,
    )
