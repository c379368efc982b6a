"""The same networks, studied alike on several data sets: another split, sensor or light, or recordings."""

from collections.abc import Iterable
from dataclasses import fields

import pandas as pd

from tacevo.records import to_json
from tacevo.results.study import RecordedStudy
from tacevo.results.study_lines import Design
from tacevo.storage.canonical import content_hash

#: A study on some data, and what it says of the variants; None where it could not be compared.
OnData = tuple[RecordedStudy, pd.DataFrame | None]


def transfers(studies: Iterable[OnData]) -> tuple[tuple[OnData, ...], ...]:
    """Find the studies of a run that differ in their data only: one of each data set, that of the run's data first."""
    groups: dict[str, dict[str, OnData]] = {}
    for study, found in studies:
        groups.setdefault(_shared(study), {}).setdefault(study.fingerprint, (study, found))
    return tuple(
        tuple(sorted(group.values(), key=lambda pair: (bool(pair[0].other_data), pair[0].where)))
        for group in groups.values()
        if len(group) > 1
    )


def is_alone(study: RecordedStudy, others: Iterable[RecordedStudy]) -> bool:
    """Return whether no other study has its networks, alike, on other data."""
    return not any(_shared(one) == _shared(study) and one.fingerprint != study.fingerprint for one in others)


def _shared(study: RecordedStudy) -> str:
    """Name what a study has in common with itself on other data; a plan is of one of them, and changes no score."""
    kept = {field.name for field in fields(Design)} - {"data", "other_data", "plan"}
    return content_hash({name: to_json(getattr(study, name)) for name in kept})
