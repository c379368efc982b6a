"""The keys that a user may set, and what each takes, in words: read off the schema of `tacevo.config.schema`."""

from dataclasses import is_dataclass
from enum import Enum
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

from tacevo.config.schema import RunConfig

_WORDS = {int: "a whole number", float: "a number", bool: "true or false", str: "a text"}


def keys(schema: type = RunConfig, prefix: str = "") -> list[str]:
    """List every key of a schema, e.g. `archive.niches`."""
    found = []
    for name, kind in get_type_hints(schema).items():
        nested = keys(kind, f"{prefix}{name}.") if _is_group(kind) else []
        found += [f"{prefix}{name}", *nested]
    return found


def expected(key: str, schema: type = RunConfig) -> str | None:
    """Say what a key takes, e.g. `a whole number`; None where there is no such key.

    Args:
        key: as a user writes it, e.g. `data.image_size`.
        schema: whose key it is.
    """
    kind: Any = schema
    for name in key.split("."):
        if not _is_group(kind) or name not in get_type_hints(kind):
            return None
        kind = get_type_hints(kind)[name]
    if _is_group(kind):
        return f"its settings one by one, e.g. {key}.{next(iter(get_type_hints(kind)))}=VALUE"
    return _in_words(kind)


def _is_group(kind: Any) -> bool:
    return isinstance(kind, type) and is_dataclass(kind)


def _in_words(kind: Any) -> str:
    """Say what the type of one setting means to a user."""
    if isinstance(kind, type) and issubclass(kind, Enum):
        return f"one of {', '.join(member.name for member in kind)}"
    if get_origin(kind) is UnionType:
        return " or ".join("null" if part is NoneType else _in_words(part) for part in get_args(kind))
    if get_origin(kind) is list:
        return f"a list in brackets, each item {_in_words(get_args(kind)[0])}"
    return _WORDS[kind]
