"""Parts that a configuration chooses by name, made from its settings."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from tacevo.config.schema import RunConfig
from tacevo.parts.kinds import EXECUTORS, PROVIDERS, SOURCES, TRACKERS, Kind
from tacevo.parts.making import Given, made
from tacevo.parts.registry import find
from tacevo.records import Json

#: Kinds whose settings name one part, which decides no results.
_KINDS = (PROVIDERS, SOURCES, EXECUTORS, TRACKERS)


def check_parts(config: RunConfig) -> None:
    """Check that the parts that a user chooses are there; a recorded run is read without them.

    Raises:
        ConfigError: one is not, as of `tacevo.parts.registry.find`.
    """
    for kind in _KINDS:
        find(kind, chosen(config, kind))


def chosen(config: RunConfig, kind: Kind) -> str:
    """Return the name of the part of a kind that a configuration chooses."""
    group, _, setting = kind.setting.partition(".")
    return str(getattr(getattr(config, group), setting))


def own_settings(config: RunConfig, name: str) -> Mapping[str, Json]:
    """Return the settings of a part's own, which no other part has: of `FILE.py:CLASS`, under the class's name."""
    parts: Mapping[str, Mapping[str, Json]] = getattr(config, "parts", {})
    return parts.get(name.rpartition(":")[2], {})


def part_of(config: RunConfig, kind: Kind, *, prices: Any = None) -> Any:
    """Import and make the part of a kind that a configuration chooses; raises as `tacevo.parts.making.made`."""
    part = find(kind, chosen(config, kind))
    group = kind.setting.partition(".")[0]
    settings = getattr(config, group)
    given = Given(
        group=group,
        settings={field.name: getattr(settings, field.name) for field in fields(settings)},
        own=own_settings(config, part.name),
        task=config.task.name,
        root=Path(config.store.root),
        prices=prices,
    )
    return made(part, given)
