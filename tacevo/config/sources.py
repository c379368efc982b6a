"""Which settings of `data` each source uses; one without effect is refused where a user sets it."""

from collections.abc import Callable, Mapping
from dataclasses import fields

from tacevo.choices import DataSource, RecordedTask, SplitRule
from tacevo.config.schema import DataConfig, RunConfig
from tacevo.errors import ConfigError
from tacevo.records import Json
from tacevo.storage.canonical import canonical

_COMMON = frozenset({"source", "image_size", "split", "split_seed", "validation_part", "test_part", "normalisation"})

#: The settings that a source uses, where `_NEEDS` holds.
USED: Mapping[DataSource, frozenset[str]] = {
    DataSource.simulated: _COMMON | {"images", "seed", "sensor", "sensor_seed", "light", "gel_mm", "spacings_mm"},
    DataSource.csv: _COMMON
    | {"root", "table", "image_column", "target_columns", "skip_missing"}
    | {"white_point", "group_column", "group_pattern"},
    DataSource.folder: _COMMON | {"root", "white_point", "group_pattern"},
    DataSource.tacverse: _COMMON
    | {"root", "sensor", "pattern", "skip_missing", "white_point", "group_pattern"}
    | {"select", "images", "spacings_mm", "classes", "test_sensor", "shots"},
    DataSource.numpy: _COMMON | {"root", "white_point"},
    DataSource.table: frozenset({"source", "root", "image_size"}),
}


#: Tasks whose images TacVerse does not list in a table.
_PRESSED = (RecordedTask.grating, RecordedTask.shape)


def _has_gratings(config: RunConfig) -> bool:
    return config.task.name == RecordedTask.grating


def _is_random(config: RunConfig) -> bool:
    return config.data.split is SplitRule.random


def _selects(config: RunConfig) -> bool:
    return config.data.source is not DataSource.tacverse or config.data.select


#: What else a setting needs, in words and as a rule.
_NEEDS: Mapping[str, tuple[str, Callable[[RunConfig], bool]]] = {
    "images": ("data.select=true", _selects),
    "spacings_mm": ("task=grating and data.select=true", lambda config: _has_gratings(config) and _selects(config)),
    "pattern": ("task=grating", _has_gratings),
    "classes": ("task=grating", _has_gratings),
    "skip_missing": (
        "a table",
        lambda config: config.data.source is DataSource.csv or config.task.name not in _PRESSED,
    ),
    "group_pattern": (
        "data.split=random, and a task whose presses the release does not name",
        lambda config: (
            _is_random(config) and (config.data.source is not DataSource.tacverse or not _has_gratings(config))
        ),
    ),
    "test_sensor": ("data.split=release", lambda config: not _is_random(config)),
    "shots": ("data.test_sensor", lambda config: config.data.test_sensor is not None),
    "split_seed": ("data.split=random or data.shots", lambda config: _is_random(config) or config.data.shots > 0),
    **dict.fromkeys(("validation_part", "test_part"), ("data.split=random", _is_random)),
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
