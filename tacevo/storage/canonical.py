"""Canonical JSON: one text and one hash for a value."""

import hashlib
import json
from collections.abc import Iterator, Mapping

from tacevo.records import Json

#: The way to a value inside a request: names of fields, which may hold any character, and places in lists.
Field = tuple[str | int, ...]


def leaves(nested: Mapping[str, Json], prefix: str = "") -> Iterator[tuple[str, Json]]:
    """Walk nested settings in their order: `{"llm": {"model": "m"}}` gives `("llm.model", "m")`.

    What holds no settings is a leaf: a list, and an empty mapping too.
    """
    for name, value in nested.items():
        if isinstance(value, Mapping) and value:
            yield from leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def canonical(value: Json) -> str:
    """Write JSON in its one canonical form: sorted keys, no spaces, no NaN.

    Raises:
        ValueError: a float is NaN or infinite.
    """
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def content_hash(value: Json) -> str:
    """Hash JSON by its canonical form: 64 hex digits of SHA-256."""
    return hashlib.sha256(canonical(value).encode()).hexdigest()


def readable(value: Json) -> str:
    """Write JSON as files have it that people read: indented, in the given order, no NaN."""
    return json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def differences(recorded: Json, asked: Json, at: Field = ()) -> list[Field]:
    """List the fields in which two requests differ, e.g. `("messages", 0, "content")`, below the field `at`."""
    if isinstance(recorded, dict) and isinstance(asked, dict):
        fields: list[Field] = []
        for key in sorted(recorded.keys() | asked.keys()):
            shared = key in recorded and key in asked
            fields += differences(recorded[key], asked[key], (*at, key)) if shared else [(*at, key)]
        return fields
    if isinstance(recorded, list) and isinstance(asked, list) and len(recorded) == len(asked):
        pairs = enumerate(zip(recorded, asked, strict=True))
        return [field for index, (a, b) in pairs for field in differences(a, b, (*at, index))]
    return [] if canonical(recorded) == canonical(asked) else [at]  # 1 and 1.0 are two keys


def shown(field: Field) -> str:
    """Write a field for a person, e.g. `messages.0.content`; the value itself is `request`."""
    return ".".join(map(str, field)) if field else "request"


def value_at(value: Json, field: Field) -> Json:
    """Look a field up that `differences` found; None where it is missing."""
    for name in field:
        if isinstance(value, list):
            value = value[int(name)]
        else:
            value = value.get(str(name)) if isinstance(value, Mapping) else None
    return value
