"""`tacevo replay RUN --diff OTHER`: where two recorded runs part, and how far they agree beyond that.

Nothing is run again: both ledgers are read, checked line by line, and held against each other. What agrees is said to
agree (tier C of docs/determinism.md); only ledgers without any difference are called equal.
"""

import json
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from scipy.stats import spearmanr

from tacevo.choices import ArchiveKind
from tacevo.errors import RunError
from tacevo.records import Json
from tacevo.storage.canonical import differences, shown, value_at
from tacevo.storage.ledger import first_difference, place_of, unsealed
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.study_directory import studies_of
from tacevo.text import counted

#: Settings that say where a run lies, and nothing about the run.
_PLACES = {"run.dir", "store.root"}

#: What is shown of a run's end.
_FIGURES = ("best", "coverage", "qd_score")

#: Ranks of fewer values say nothing.
_LEAST_RANKED = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """A finished run as it is compared."""

    #: As in run.json.
    config: Mapping[str, Json]
    #: All lines, the header first.
    ledger: Sequence[dict[str, Json]]
    #: Of every trained source, by its hash.
    fitness: Mapping[str, float]
    #: Figures of the last generation.
    end: Mapping[str, Json]
    #: Hashes of the elites' sources, by niche of the final network archive.
    elites: Mapping[int, str]
    #: Lines of every finished study by what it is, e.g. `4 elites, 20 seeds, 50 epochs`; the header first.
    studies: Mapping[str, Sequence[dict[str, Json]]]


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
    #: Spearman's, in [-1, 1]; None where fewer than three sources are shared, or a run gave them all one fitness.
    rank_correlation: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Overlap:
    """What two final archives have in common."""

    #: Elites of each.
    elites: tuple[int, int]
    #: Sources that are elites of both.
    sources: int
    #: Niches that both fill, and those of them with one source; None where the niches differ, or there are none.
    niches: tuple[int, int] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyAgreement:
    """How the scores of one study compare in two runs."""

    name: str
    #: Rows of both, and those that are equal.
    rows: int
    same: int
    first: Divergence | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Two runs, held against each other."""

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
    ends: tuple[Mapping[str, Json], Mapping[str, Json]]
    studies: tuple[StudyAgreement, ...]

    @property
    def is_equal(self) -> bool:
        """Whether the ledgers are the same."""
        return self.divergence is None and self.lines[0] == self.lines[1]


def read_recorded(path: Path) -> Recorded:
    """Read a finished run to be compared.

    Raises:
        RunError: it is not finished, or something of it was damaged or edited.
    """
    directory = RunDirectory(path)
    ledger = directory.read_finished()
    with directory.believed():
        finished = [study.read_scores() for study in studies_of(path) if study.read()["digest"] is not None]
        studies = {_kind_of_study(scores[0]): scores for scores in finished}
        sources = {line["id"]: line["source"] for line in ledger if "fitness" in line}
        elites = {int(niche): str(sources[name]) for niche, name in directory.read_niches().items()}
        return Recorded(
            config=dict(directory.read_run()["config"]),
            ledger=ledger,
            fitness=fitness_by_source(ledger),
            end=last_generation(ledger),
            elites=elites,
            studies=studies,
        )


def compare(one: Recorded, other: Recorded) -> Comparison:
    """Hold two runs against each other.

    Raises:
        RunError: one of them holds something that no search writes.
    """
    try:
        return _compare(one, other)
    except RecursionError as error:
        raise RunError("one of the runs holds a value that is nested deeper than any that a search writes") from error


def _compare(one: Recorded, other: Recorded) -> Comparison:
    pairs = list(zip(one.ledger, other.ledger, strict=False))
    places = (place for place, pair in enumerate(pairs) if unsealed(pair[0]) != unsealed(pair[1]))
    first, second = next(places, None), next(places, None)
    header_differs = first == 0
    return Comparison(
        lines=(len(one.ledger), len(other.ledger)),
        equal=len(pairs) if first is None else first,
        divergence=None if first is None else _divergence(*pairs[first]),
        decision=_divergence(*pairs[second]) if header_differs and second is not None else None,
        settings=tuple(_settings(one.config, other.config)),
        agreement=agreement(one.fitness, other.fitness),
        overlap=_overlap(one, other),
        ends=(one.end, other.end),
        studies=tuple(
            _study(name, one.studies[name][1:], other.studies[name][1:])
            for name in one.studies
            if name in other.studies
        ),
    )


def fitness_by_source(ledger: Iterable[Mapping[str, Json]]) -> dict[str, float]:
    """Give the fitness of every trained source by its hash."""
    return {str(line["source"]): float(line["fitness"]) for line in ledger if "fitness" in line}


def last_generation(ledger: Sequence[Mapping[str, Json]]) -> Mapping[str, Json]:
    """Give the figures of a run's end: the last line of a generation.

    Raises:
        IndexError: there is none.
    """
    line = [line for line in ledger if line["kind"] == "generation"][-1]
    return {name: line[name] for name in _FIGURES}


def agreement(one: Mapping[str, float], other: Mapping[str, float]) -> Agreement:
    """Compare the fitness of the sources that two runs share.

    Args:
        one: fitness by source.
        other: the same, of the other run.
    """
    shared = sorted(one.keys() & other.keys())
    first, second = [one[source] for source in shared], [other[source] for source in shared]
    apart = [abs(a - b) for a, b in zip(first, second, strict=True)]
    ranked = len(shared) >= _LEAST_RANKED and len(set(first)) > 1 and len(set(second)) > 1
    return Agreement(
        shared=len(shared),
        same=sum(difference == 0 for difference in apart),
        largest=max(apart, default=0.0),
        median=statistics.median(apart) if apart else 0.0,
        rank_correlation=float(spearmanr(first, second).statistic) if ranked else None,
    )


def describe(found: Comparison) -> str:
    """Say what was found, for a person."""
    return "\n".join(
        [
            *_parting(found),
            *(f"setting {setting.field}: {setting.values[0]} and {setting.values[1]}" for setting in found.settings),
            *_agreeing(found.agreement),
            *_ends(found),
            *(_of_study(study) for study in found.studies),
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
    ranks = "undefined" if found.rank_correlation is None else f"{found.rank_correlation:.4f}"
    return [
        f"{counted(found.shared, 'source')} trained in both: {found.same} with the same fitness; differences up to "
        f"{found.largest:.3g}, median {found.median:.3g}; rank correlation {ranks}"
    ]


def _ends(found: Comparison) -> list[str]:
    overlap, (one, other) = found.overlap, found.ends
    shared = f"elites: {overlap.elites[0]} and {overlap.elites[1]}; {overlap.sources} sources are elites of both"
    if overlap.niches is None:
        shared += "; the niches are others, or there are none, so they are not compared"
    else:
        shared += f"; {overlap.niches[0]} niches are filled in both, {overlap.niches[1]} of them by one source"
    return [
        *(f"{name.replace('_', ' ')}: {one[name]} and {other[name]}" for name in _FIGURES),
        shared,
    ]


def _of_study(study: StudyAgreement) -> str:
    same = f"study of {study.name}: {study.same} of {study.rows} scores are equal"
    return same if study.first is None else f"{same}; first difference: {study.first}"


def _divergence(one: dict[str, Json], other: dict[str, Json]) -> Divergence:
    field, values = first_difference(one, other)
    return Divergence(place=place_of(one), field=field, values=values)


def _settings(one: Mapping[str, Json], other: Mapping[str, Json]) -> Iterable[Divergence]:
    for field in differences(dict(one), dict(other)):
        if shown(field) not in _PLACES:
            values = (json.dumps(value_at(one, field)), json.dumps(value_at(other, field)))
            yield Divergence(place=str(field[0]), field=shown(field), values=values)


def _overlap(one: Recorded, other: Recorded) -> Overlap:
    first, second = one.elites, other.elites
    both = first.keys() & second.keys()
    alike = one.ledger[0].get("centroids") == other.ledger[0].get("centroids") and _has_niches(one)
    return Overlap(
        elites=(len(first), len(second)),
        sources=len(set(first.values()) & set(second.values())),
        niches=(len(both), sum(first[niche] == second[niche] for niche in both)) if alike else None,
    )


def _has_niches(run: Recorded) -> bool:
    """Say whether a run's archive has niches; the places of one that has none mean nothing in another."""
    return ArchiveKind(run.config["archive"].get("kind", ArchiveKind.cvt)) is ArchiveKind.cvt


def _kind_of_study(header: Mapping[str, Json]) -> str:
    elites = len(header["networks"]) - 1
    return f"{elites} elites, {header['seeds']} seeds, {header['recipe']['epochs']} epochs"


def _study(name: str, one: Sequence[dict[str, Json]], other: Sequence[dict[str, Json]]) -> StudyAgreement:
    pairs = list(zip(one, other, strict=False))
    apart = [pair for pair in pairs if unsealed(pair[0]) != unsealed(pair[1])]
    first = next((_divergence(*pair) for pair in islice(apart, 1)), None)
    return StudyAgreement(name=name, rows=len(pairs), same=len(pairs) - len(apart), first=first)
