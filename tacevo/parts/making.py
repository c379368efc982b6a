"""Parts are made from their settings."""

import json
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, TypeVar

from tacevo.errors import ConfigError
from tacevo.parts.registry import Part
from tacevo.records import Json, to_json
from tacevo.text import listed, nearest
from tacevo.typed import convert


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Given:
    """The settings that a part is made from."""

    #: The group of the part, such as `data`, and the settings there by name, as the configuration has them.
    group: str
    settings: Mapping[str, Any]
    #: The part's own settings, `parts.NAME.*`.
    own: Mapping[str, Json]
    #: The name of the task.
    task: str
    #: The directory of the stores.
    root: Path
    #: The prices of models, for a provider (`tacevo.llm.prices.PriceTable`).
    prices: Any = None


T = TypeVar("T", bound=StrEnum)


def task_among(tasks: type[T], given: Given) -> T:
    """Find the task of a configuration among those that a source knows.

    Raises:
        ConfigError: the source does not know it.
    """
    try:
        return tasks(given.task)
    except ValueError as error:
        raise ConfigError(
            given.task,
            place=f"task.name with data={given.settings['source']}",
            expected=f"one of {', '.join(tasks)}",
            remedy="choose other data",
        ) from error


def made(part: Part, given: Given) -> Any:
    """Import a part, and make it.

    A part is a frozen dataclass, whose fields are settings: those of its group and `task` by their names there, all
    others its own. One of ours may be a function of `Given` in its place.

    Raises:
        ConfigError: it cannot be imported, or a setting is missing, of the wrong type, or not one of its own.
    """
    loaded = part.load()
    if isinstance(loaded, type) and is_dataclass(loaded):
        return _from_fields(loaded, part, given)
    if part.is_ours:
        return loaded(given)
    raise ConfigError(repr(loaded), place=part.place, expected=f"{part.attribute} to be a frozen dataclass")


def _from_fields(kind: type[Any], part: Part, given: Given) -> Any:
    known = {field.name: field for field in fields(kind) if field.init}
    common = {**given.settings, "task": given.task}
    own = [name for name in known if name not in common]
    for name in given.own:
        if name not in own:
            place, expected = f"parts.{part.name}.{name}", f"one of {listed(own)}" if own else "no setting of its own"
            raise ConfigError(
                json.dumps(given.own[name]), place=place, expected=expected, remedy=nearest(name, own, "")
            )
    values: dict[str, Json] = {name: to_json(common[name]) for name in known if name in common}
    values |= given.own
    for name in own:
        field = known[name]
        if name not in values and field.default is MISSING and field.default_factory is MISSING:
            raise ConfigError("nothing", place=f"parts.{part.name}.{name}", expected="a value")
    try:
        return convert(kind, values, place="", error=ConfigError)
    except ConfigError as error:
        key = error.place.partition(".")[0]
        group = f"parts.{part.name}" if key not in common else "task" if key == "task" else given.group
        error.place = f"{group}.name" if key == "task" else f"{group}.{error.place}"
        raise
