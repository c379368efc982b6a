"""`tacevo replay RUN --diff OTHER`: where two recorded runs part, and how far they agree beyond that.

Nothing is run again: both ledgers were read and checked line by line, and are compared. What agrees is said to
agree (tier C of docs/determinism.md); only ledgers without any difference are called equal.
"""

import json
from collections.abc import Iterator, Sequence
from statistics import median

from tacevo.evolution.run_files import Line
from tacevo.results.run import RecordedRun
from tacevo.storage.canonical import differences, shown, value_at
from tacevo.storage.ledger import first_difference, place_of
from tacevo.text import counted

#: Settings that say where a run lies, and nothing about the run.
_PLACES = {"run.dir", "store.root"}


def compare(one: RecordedRun, other: RecordedRun) -> tuple[bool, str]:
    """Compare two runs; return whether their ledgers are equal, and what is to be said, for a person."""
    ledgers = one.ledger.lines, other.ledger.lines
    said = [*_parting(*ledgers), *_settings(one, other), *_agreeing(one, other), *_ends(one, other)]
    return ledgers[0] == ledgers[1], "\n".join(said)


def _parting(one: Sequence[Line], other: Sequence[Line]) -> Iterator[str]:
    """Say where two ledgers part; where their headers differ already, where their decisions do, too."""
    if one == other:
        yield f"the ledgers are equal: {counted(len(one), 'line')}"
        return
    pairs = list(zip(one, other, strict=False))
    parting = [place for place, (first, second) in enumerate(pairs) if first != second]
    equal = parting[0] if parting else len(pairs)
    yield f"equal: the first {counted(equal, 'line')}, of {len(one)} and {len(other)}"
    if not parting:
        yield f"the {'second' if len(other) > len(one) else 'first'} run goes on where the other ends"
        return
    yield f"first difference: {_difference(*pairs[equal])}"
    if equal == 0 and len(parting) > 1:
        yield f"first difference behind the header: {_difference(*pairs[parting[1]])}"


def _difference(one: Line, other: Line) -> str:
    field, (was, now) = first_difference(one, other)
    return f"{place_of(one)}: field {field!r} is {was} in the first run and {now} in the second"


def _settings(one: RecordedRun, other: RecordedRun) -> Iterator[str]:
    configs = one.record.config, other.record.config
    for field in differences(*configs):
        if shown(field) not in _PLACES:
            first, second = (json.dumps(value_at(config, field)) for config in configs)
            yield f"setting {shown(field)}: {first} and {second}"


def _agreeing(one: RecordedRun, other: RecordedRun) -> Iterator[str]:
    """Compare the fitness of the sources that both runs trained."""
    first, second = (
        {line.source: line.fitness for line in run.candidates if line.source and line.fitness is not None}
        for run in (one, other)
    )
    apart = [abs(first[source] - second[source]) for source in first.keys() & second.keys()]
    if not apart:
        yield "no source was trained in both runs"
        return
    yield (
        f"{counted(len(apart), 'source')} trained in both: {apart.count(0)} with the same fitness; differences up to "
        f"{max(apart):.3g}, median {median(apart):.3g}"
    )


def _ends(one: RecordedRun, other: RecordedRun) -> Iterator[str]:
    """Compare the last generations and the final archives."""
    last = one.generations[-1], other.generations[-1]
    for figure in ("best", "coverage", "qd_score"):
        yield f"{figure.replace('_', ' ')}: {getattr(last[0], figure)} and {getattr(last[1], figure)}"
    first, second = _elites(one), _elites(other)
    sources = len(set(first.values()) & set(second.values()))
    shared = f"elites: {len(first)} and {len(second)}; {sources} sources are elites of both"
    # Places of an archive without niches mean nothing in another.
    if one.has_niches and other.has_niches and one.header.centroids == other.header.centroids:
        both = first.keys() & second.keys()
        same = sum(first[niche] == second[niche] for niche in both)
        yield f"{shared}; {len(both)} niches are filled in both, {same} of them by one source"
    else:
        yield f"{shared}; niches are not compared: the runs have different ones, or none"


def _elites(run: RecordedRun) -> dict[int, str | None]:
    """Return the hashes of the elites' sources, by niche of the final archive."""
    sources = {line.id: line.source for line in run.candidates}
    return {elite.niche: sources[elite.id] for elite in run.elites}
