"""Parts that a configuration chooses by name, made from its settings."""

from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

from tacevo.config.recorded_parts import chosen, not_ours
from tacevo.config.schema import RunConfig
from tacevo.errors import ConfigError
from tacevo.parts.kinds import KINDS, Kind
from tacevo.parts.making import Given, made
from tacevo.parts.registry import Part, find
from tacevo.records import Json, to_json

#: The text that stands for a setting that must be given, as Hydra writes it.
UNGIVEN = "???"

#: Kinds whose settings name one part, which decides no results.
_KINDS = tuple(kind for kind in KINDS.values() if kind.setting and not kind.decides)


def check_parts(config: RunConfig) -> None:
    """Check that the parts that a user chooses are there, and others' can be made; a recorded run is read without.

    Raises:
        ConfigError: one is not there, or refuses its settings.
    """
    for kind in _KINDS:
        (name,) = chosen(config, kind)
        if not find(kind, name).is_ours:
            part_of(config, kind)


@dataclass(frozen=True, slots=True)
class OpenPart:
    """A part that decides nothing and that a user brought: it runs in this process."""

    name: str
    #: The part's own settings at their defaults; `UNGIVEN` where one must be given.
    settings: Mapping[str, Json]


def names_open(plain: Mapping[str, Any]) -> bool:
    """Answer whether a composed configuration names a part that decides nothing and is not ours."""
    return any(not_ours(plain, kind) for kind in _KINDS)


def open_parts(plain: Mapping[str, Any]) -> list[OpenPart]:
    """Import the parts that a composed configuration names, as far as they decide nothing and are not ours.

    Raises:
        ConfigError: there is none of the name, or it cannot be imported.
    """
    found = []
    for kind in _KINDS:
        group, _ = kind.key
        for name in not_ours(plain, kind):
            name_file(name)
            part = find(kind, name)
            loaded = part.load()
            known = fields(loaded) if is_dataclass(loaded) else ()
            own = {each.name: _default(each) for each in known if each.name not in {*plain[group], "task"}}
            found.append(OpenPart(part.name, own))
    return found


def _default(setting: Field[Any]) -> Json:
    if setting.default_factory is not MISSING:
        made: Json = to_json(setting.default_factory())
        return made
    default: Json = UNGIVEN if setting.default is MISSING else to_json(setting.default)
    return default


#: Files with parts that the user of this process has named: those of a recorded configuration may be a stranger's.
_NAMED: set[str] = set()


def name_file(value: str) -> None:
    """Note that the user of this process names a part, as a setting or in a configuration that he composes."""
    _NAMED.add(value)


def _check_named(part: Part, name: str) -> None:
    if part.file is not None and name not in _NAMED:
        raise ConfigError(
            f"{name}, a file that only the record names",
            place=part.kind.setting,
            expected="a part whose code the user of this machine names",
            remedy=f"read that file; if you trust it, name it: {part.kind.setting}={name}",
        )


def part_of(config: RunConfig, kind: Kind, *, prices: Any = None) -> Any:
    """Import and make the part of a kind that a configuration chooses; raises as `tacevo.parts.making.made`."""
    (name,) = chosen(config, kind)
    part = find(kind, name)
    _check_named(part, name)
    group, _ = kind.key
    settings = getattr(config, group)
    given = Given(
        group=group,
        settings={field.name: getattr(settings, field.name) for field in fields(settings)},
        own=config.own_settings(part.name),
        task=config.task.name,
        root=Path(config.store.root),
        prices=prices,
    )
    return made(part, given)
