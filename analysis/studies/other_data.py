"""Studies of the same networks, alike, on other data."""

from collections.abc import Iterable
from dataclasses import fields

from tacevo.records import to_json
from tacevo.results.study import RecordedStudy
from tacevo.results.study_lines import Design
from tacevo.storage.canonical import content_hash


def is_alone(study: RecordedStudy, others: Iterable[RecordedStudy]) -> bool:
    """Return whether no other study has its networks, alike, on other data."""
    return not any(shared_terms(one) == shared_terms(study) and one.fingerprint != study.fingerprint for one in others)


def shared_terms(study: RecordedStudy) -> str:
    """Name what a study has in common with itself on other data; a plan is of one of them, and changes no score."""
    kept = {field.name for field in fields(Design)} - {"data", "other_data", "plan"}
    return content_hash({name: to_json(getattr(study, name)) for name in kept})
