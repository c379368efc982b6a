"""Finished studies as another release would have left them: entries, scores and description agree."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from tacevo.records import Json, written
from tacevo.results.study_directory import StudyDirectory, plain_study, study_names
from tacevo.results.study_lines import Row, StudyHeader
from tacevo.storage.canonical import readable
from tacevo.storage.ledger import sealed_text
from tacevo.storage.store import Entry, place_of, read_entry, write_entry


def rewrite_study(study: StudyDirectory, store: Path, **changes: Any) -> StudyDirectory:
    """Write a study anew with other values of its design; its trainings stand in the store under the keys of these."""
    scores = study.read_scores()
    header = replace(scores.header, **changes)
    rows = [replace(row, evaluation=_moved(store, row.evaluation, _asked(header))) for row in scores.rows]
    moved = StudyDirectory(study.path.with_name(study_names(header, searched=True)[0]))
    study.path.rename(moved.path)
    write_study(moved, header, rows, **changes, name=moved.path.name)
    return moved


def write_study(study: StudyDirectory, header: StudyHeader, rows: list[Row], **changes: Any) -> None:
    """Write the scores of a study, and its description with these changes."""
    text, digest = sealed_text([header, *rows])
    told = replace(study.read(), **changes, digest=digest)
    study.scores.write_text(text)
    (study.path / "study.json").write_text(readable(plain_study(told)))


def _asked(header: StudyHeader) -> dict[str, Json]:
    """Return what a request for a training has from the design of its study."""
    device = {"device": header.device.value} if header.recipe.gpu else {}
    return {
        "version": header.rules,
        "recipe": written(header.recipe),
        "numerics": header.numerics.value,
        "data": header.data.fingerprint,
        **device,
    }


def _moved(store: Path, key: str, asked: Mapping[str, Json]) -> str:
    """Record the answer of an entry under another request; return the key of that."""
    path = store / place_of("studies", key)
    entry = read_entry(path)
    assert isinstance(entry.request, dict)
    other = Entry(kind=entry.kind, request={**entry.request, **asked}, answer=entry.answer)
    path.unlink()
    write_entry(store, other)
    return other.key
