"""Settings, values and choices of earlier releases: refused by name, unless they say nothing.

Configurations of older runs hold settings that are gone. Most of them said nothing there, and are read as if they were
not there; a run that used one cannot be read, and its error says what to use now.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tacevo.errors import ConfigError
from tacevo.records import Json


@dataclass(frozen=True, slots=True, kw_only=True)
class _Setting:
    """A setting that is gone."""

    #: The setting of its group that it stood behind in run.json.
    behind: str
    default: int | float
    #: The remedy: what a user can do now.
    instead: str
    #: Whether it worked by itself, and not only beside a value that is refused.
    worked_alone: bool = False

    def says_nothing(self, value: Json) -> bool:
        """Answer whether a run with this value is as one without this setting."""
        return type(value) is type(self.default) and (value == self.default or not self.worked_alone)


_AGEING = "set proposals.parents=best_k, which selects as strongly without niches"

_EXTRACT = "set archive.kind=cvt, and train elites again after the search: `tacevo noise RUN`"

_SEEDS = "leave it out, and train elites again after the search: `tacevo noise RUN`"

_SETTINGS = {
    "archive.reevaluated": _Setting(behind="kept", default=0.25, instead=_EXTRACT),
    "proposals.population": _Setting(behind="skipped", default=100, instead=_AGEING),
    "proposals.tournament": _Setting(behind="population", default=25, instead=_AGEING),
    "training.seeds": _Setting(
        behind="fitness",
        default=1,
        instead=f"{_SEEDS}; `tacevo tabulate --seeds N` trains each network of a table N times",
        worked_alone=True,
    ),
}

#: Values of settings, and choices of groups.
_VALUES = {
    "archive.kind=extract": _EXTRACT,
    "archive=extract": "choose archive=cvt, and train elites again after the search: `tacevo noise RUN`",
    "ablation=extract": "choose ablation=none, and train elites again after the search: `tacevo noise RUN`",
    "proposals.parents=tournament": _AGEING,
    "ablation=three_seeds": _SEEDS,
    "ablation=regularised_evolution": "compare with ablation=best_k, which selects as strongly without niches",
}


def removed(what: str) -> ConfigError | None:
    """Return the error for KEY or KEY=VALUE, where that was removed."""
    key = what.partition("=")[0]
    instead = _SETTINGS[key].instead if key in _SETTINGS else _VALUES.get(what)
    if instead is None:
        return None
    return ConfigError(f"{what}, which was removed", place=key, expected="a setting of this release", remedy=instead)


def without_removed(plain: Mapping[str, Json]) -> dict[str, Json]:
    """Return a nested configuration without the settings that were removed and say nothing in it.

    Raises:
        ConfigError: one says something; its place is the key.
    """
    kept: dict[str, Any] = {}
    for group, settings in plain.items():
        kept[group] = settings
        if not isinstance(settings, Mapping):
            continue
        kept[group] = {}
        for name, value in settings.items():
            key = f"{group}.{name}"
            setting = _SETTINGS.get(key)
            if setting is not None and setting.says_nothing(value):
                continue
            if error := removed(f"{key}={value}"):
                raise error
            kept[group][name] = value
    return kept


def with_removed(plain: Mapping[str, Json], recorded: Mapping[str, Json]) -> dict[str, Json]:
    """Return a nested configuration with the removed settings that a recorded one has, in the places that they had."""
    whole: dict[str, Any] = dict(plain)
    for key, gone in _SETTINGS.items():
        group, _, name = key.partition(".")
        held: Any = recorded[group]
        if name in held:
            settings = [*whole[group].items()]
            end = [*whole[group]].index(gone.behind) + 1
            whole[group] = dict([*settings[:end], (name, held[name]), *settings[end:]])
    return whole
