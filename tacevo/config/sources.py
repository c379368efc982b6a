"""Which settings of `data` each source uses; one without effect is refused where a user sets it."""

from collections.abc import Callable, Mapping
from dataclasses import fields

from tacevo.choices import DataSource, SensorTask, SplitRule
from tacevo.config.schema import DataConfig, RunConfig
from tacevo.errors import ConfigError
from tacevo.records import Json
from tacevo.storage.canonical import canonical

_COMMON = frozenset({"source", "image_size", "split", "split_seed", "validation_part", "test_part", "normalisation"})

#: The settings that a source uses, where `_NEEDS` holds.
USED: Mapping[DataSource, frozenset[str]] = {
    DataSource.simulated: _COMMON | {"images", "seed", "sensor_seed", "light", "spacings_mm"},
    DataSource.csv: _COMMON
    | {"root", "table", "image_column", "target_columns", "skip_missing"}
    | {"white_point", "group_column", "group_pattern"},
    DataSource.folder: _COMMON | {"root", "white_point", "group_pattern"},
    DataSource.tacverse: _COMMON | {"root", "sensor", "pattern", "skip_missing", "white_point"},
    DataSource.numpy: _COMMON | {"root", "white_point"},
}


def _has_gratings(config: RunConfig) -> bool:
    return config.task.name == SensorTask.grating


def _is_random(config: RunConfig) -> bool:
    return config.data.split is SplitRule.random


#: What else a setting needs, in words and as a rule.
_NEEDS: Mapping[str, tuple[str, Callable[[RunConfig], bool]]] = {
    "spacings_mm": ("task=grating", _has_gratings),
    "pattern": ("task=grating", _has_gratings),
    "skip_missing": ("a table", lambda config: config.data.source is DataSource.csv or not _has_gratings(config)),
    **dict.fromkeys(("split_seed", "validation_part", "test_part"), ("data.split=random", _is_random)),
}


def unused(config: RunConfig) -> frozenset[str]:
    """Return the settings of `data` without effect in a configuration, by their names there."""
    used = {name for name in USED[config.data.source] if name not in _NEEDS or _NEEDS[name][1](config)}
    return frozenset(field.name for field in fields(DataConfig)) - used


def check_used(config: RunConfig, composed: Mapping[str, Json], usual: Mapping[str, Json]) -> None:
    """Raise ConfigError where a setting of `data` without effect is not what it is where the user does not set it.

    Both mappings are of these settings by name.
    """
    data = config.data
    for name in sorted(unused(config)):
        if composed[name] == usual[name]:
            continue
        sources = " or ".join(f"data={source}" for source in DataSource if name in USED[source])
        needs = f" with {_NEEDS[name][0]}" if name in _NEEDS else ""
        lacking = _NEEDS[name][0] if name in USED[data.source] else f"{sources}{needs}"
        raise ConfigError(
            canonical(composed[name]),
            place=f"data.{name}",
            expected=f"no value without {lacking}: data={data.source} does not use it",
            remedy="remove it",
        )
