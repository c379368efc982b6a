"""The parts that decide and that a user brought, found, read and asked for their settings when a search is composed.

Nothing of them runs in this process: a confined one says which settings a part has, and makes it once with them.
"""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from tacevo.config.chosen import UNGIVEN, OpenPart
from tacevo.config.recorded_parts import DECIDING, code_hash, not_ours
from tacevo.config.removed import removed
from tacevo.errors import ConfigError, PartError
from tacevo.parts.kinds import KINDS, Kind
from tacevo.parts.registry import Part, find, names
from tacevo.parts.sources import read_sources, remember
from tacevo.records import Json
from tacevo.sandbox.part_process import PartProcess, Recorded
from tacevo.text import listed, nearest

#: The answers of parts about themselves, by the question.
_ASKED: dict[str, Json] = {}

#: The types of settings, in words.
_WORDS = {"int": "an integer", "float": "a number", "bool": "true or false", "str": "text"}


@dataclass(frozen=True, slots=True)
class Setting:
    """A setting of a part."""

    #: `int`, `float`, `bool` or `str`.
    type: str
    #: The default of the setting; None where it must be given.
    default: Json


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnPart:
    """A part that decides and that a user brought."""

    recorded: Recorded
    sha256: str
    settings: Mapping[str, Setting]
    constants: Mapping[str, bool]

    @property
    def name(self) -> str:
        """The name by which a run records the part."""
        return self.recorded.name


def names_own(plain: Mapping[str, Any]) -> bool:
    """Answer whether a composed configuration names a part that decides and is not ours."""
    return any(not_ours(plain, kind) for kind in DECIDING)


def own_parts(plain: Mapping[str, Any], process: PartProcess) -> list[OwnPart]:
    """Find the parts that a composed configuration names, as far as they decide and are not ours.

    Each says what it is in `process`, and is remembered with its sources, so that a run can keep them.

    Raises:
        ConfigError: there is none of the name; or it imports what it may not.
        PartError: its class cannot be made, or has settings that a configuration cannot hold.
        SandboxError: processes cannot be confined here.
    """
    return [_described(part, process) for kind in DECIDING for part in _named(plain, kind)]


def with_names(plain: Mapping[str, Any], found: Iterable[OwnPart]) -> dict[str, Any]:
    """Return a composed configuration with what a run records of its own parts: their names, code and settings."""
    made = {group: dict(value) if isinstance(value, dict) else value for group, value in plain.items()}
    for kind in DECIDING:
        group, setting = kind.key
        value = made[group][setting]
        made[group][setting] = [_short(one) for one in value] if isinstance(value, list) else _short(value)
    made["code"] = {
        part.name: {
            "kind": part.recorded.kind.name,
            "module": part.recorded.module,
            "attribute": part.recorded.attribute,
            "sha256": part.sha256,
            "constants": dict(part.constants),
        }
        for part in found
    }
    return made


def defaults(found: Iterable[OwnPart]) -> dict[str, Json]:
    """Return the settings of parts at their defaults, by part; `UNGIVEN` where one must be given."""
    return {
        part.name: {
            name: UNGIVEN if setting.default is None else setting.default for name, setting in part.settings.items()
        }
        for part in found
    }


def checked(found: Iterable[OwnPart], given: Mapping[str, Any], process: PartProcess) -> dict[str, dict[str, Json]]:
    """Check the settings that a configuration gives parts, by their types, and by the parts themselves in `process`.

    Raises:
        ConfigError: a setting is not known, or of another type; or the part refuses its settings.
    """
    settings = {}
    for part in found:
        values = dict(given.get(part.name) or {})
        for name, value in values.items():
            check_setting(found, part.name, name)
            key, known = f"parts.{part.name}.{name}", part.settings[name]
            values[name] = float(value) if known.type == "float" and type(value) is int else value
            is_number = not isinstance(values[name], float) or math.isfinite(values[name])
            if type(values[name]).__name__ != known.type or not is_number:
                raise ConfigError(json.dumps(value), place=key, expected=_WORDS[known.type])
        _accept(part, values, process)
        settings[part.name] = values
    return settings


def check_setting(found: Iterable[OwnPart | OpenPart], name: str, setting: str) -> None:
    """Refuse a setting of a part that is neither chosen nor installed, or that a chosen one does not have.

    Raises:
        ConfigError: there is no such part or setting.
    """
    for part in found:
        if part.name == name and setting not in part.settings:
            remedy = nearest(setting, part.settings, f"its settings are {listed(part.settings)}")
            raise ConfigError("not a setting", place=f"parts.{name}.{setting}", remedy=remedy)
        if part.name == name:
            return
    known = [each for kind in KINDS.values() for each in names(kind) if each not in kind.ours]
    if name not in known:
        remedy = nearest(name, known, "`tacevo parts` lists those that are installed")
        raise ConfigError("settings of a part that nothing chooses", place=f"parts.{name}", remedy=remedy)


def _named(plain: Mapping[str, Any], kind: Kind) -> list[Part]:
    found = []
    for name in not_ours(plain, kind):
        if error := removed(f"{kind.setting}={name}"):
            raise error
        found.append(find(kind, name))
    return found


def _short(value: Any) -> Any:
    """Return what a run calls the part that a user named: of one in a file its class, so that no path is recorded."""
    return value.rpartition(":")[2] if isinstance(value, str) else value


def _described(part: Part, process: PartProcess) -> OwnPart:
    if part.name in part.kind.ours:
        raise ConfigError(part.name, place=part.kind.setting, expected="a class whose name is not one of ours")
    sources = read_sources(part)
    sha256 = code_hash(part.module, part.attribute, sources)
    remember(sha256, sources)
    recorded = Recorded(kind=part.kind, name=part.name, module=part.module, attribute=part.attribute, sources=sources)
    try:
        told: Any = _asked(process, recorded, sha256, "describe", {"constants": list(part.kind.constants)})
    except PartError as error:
        expected = f"a class that extends tacevo.parts.{part.kind.base}, a dataclass(frozen=True)"
        raise ConfigError(error.got, place=part.place, expected=expected) from error
    if told["constants"].get("has_niches") is False:
        raise ConfigError("has_niches = False", place=part.place, expected="an archive with niches")
    settings = {name: Setting(**field) for name, field in told["fields"].items()}
    return OwnPart(recorded=recorded, sha256=sha256, settings=settings, constants=told["constants"])


def _accept(part: OwnPart, values: Mapping[str, Json], process: PartProcess) -> None:
    """Let a part refuse its settings, which it may do when it is made."""
    try:
        _asked(process, replace(part.recorded, settings=values), part.sha256, "check", None)
    except PartError as error:
        raise ConfigError(error.got, place=f"parts.{part.name}", expected="settings that the part accepts") from error


def _asked(process: PartProcess, recorded: Recorded, sha256: str, method: str, given: Json) -> Json:
    """Ask a part once in this process, however many jobs of a sweep have it."""
    question = json.dumps([recorded.kind.name, sha256, dict(recorded.settings), method, given], sort_keys=True)
    if question not in _ASKED:
        _ASKED[question] = process.ask(recorded, method, given)
    return _ASKED[question]
