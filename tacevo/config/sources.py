"""Which settings of `data` each source uses, one without effect is refused; and which a study has of its own."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace

from tacevo.choices import ALL_SENSORS, DataSource, RecordedTask, SplitRule
from tacevo.config.schema import DataConfig, RunConfig
from tacevo.errors import ConfigError
from tacevo.records import Json
from tacevo.storage.canonical import canonical

_COMMON = frozenset({"source", "image_size", "split", "split_seed", "validation_part", "test_part", "normalisation"})

#: Those of a recording that names sensors and parts.
_SENSORS = frozenset({"sensor_column", "split_column", "sensor", "test_sensor", "shots"})

#: The settings that a source uses, where `_NEEDS` holds.
USED: Mapping[DataSource, frozenset[str]] = {
    DataSource.simulated: _COMMON | {"images", "seed", "sensor", "sensor_seed", "light", "gel_mm", "spacings_mm"},
    DataSource.csv: _COMMON
    | {"root", "table", "image_column", "target_columns", "skip_missing"}
    | {"white_point", "group_column", "group_pattern"}
    | _SENSORS,
    DataSource.folder: _COMMON | {"root", "white_point", "group_pattern"} | _SENSORS,
    DataSource.tacverse: _COMMON
    | {"root", "sensor", "pattern", "skip_missing", "white_point", "group_pattern"}
    | {"select", "images", "spacings_mm", "classes", "test_sensor", "shots"},
    DataSource.numpy: _COMMON | {"root", "white_point"} | _SENSORS,
    DataSource.table: frozenset({"source", "root", "image_size"}),
}


#: What a study may set for its trainings that is not its run's, beside data.
DEVICE = (
    *("numerics", "numerics.kind", "sandbox.require"),
    *("training.device", "training.gpu", "training.precision", "training.gpu_memory_mib"),
    *("training.layout", "training.captured"),
)


def is_of_data(override: str) -> bool:
    """Answer whether an override sets data."""
    return override.startswith(("data=", "data."))


def is_elsewhere(override: str) -> bool:
    """Answer whether an override sets what a study may have other than its run: data, numerics or device."""
    return is_of_data(override) or override.partition("=")[0] in DEVICE


#: Sources of recordings that a user lays out.
_NAMING = (DataSource.csv, DataSource.folder, DataSource.numpy)

#: Tasks whose images TacVerse does not list in a table.
_PRESSED = (RecordedTask.grating, RecordedTask.shape)


def _is_random(config: RunConfig) -> bool:
    return config.data.split is SplitRule.random


def _is_recorded(config: RunConfig) -> bool:
    return config.data.source is DataSource.tacverse


#: What a setting may need beside its source, in words and as a rule.
_Need = tuple[str, Callable[[RunConfig], bool]]

_NAMED: _Need = (
    "data.sensor_column",
    lambda config: config.data.source not in _NAMING or config.data.sensor_column is not None,
)
_RELEASED: _Need = ("data.split=release", lambda config: not _is_recorded(config) or not _is_random(config))
_GRATING: _Need = ("task=grating", lambda config: config.task.name == RecordedTask.grating)
_SELECTS: _Need = ("data.select=true", lambda config: config.data.select or not _is_recorded(config))
_RANDOM: _Need = ("data.split=random", _is_random)
_DEALT: _Need = (
    "data.split_column=null, or data.shots",
    lambda config: config.data.split_column is None or config.data.shots > 0,
)
_UNSPLIT: _Need = ("data.split_column=null", lambda config: config.data.split_column is None)
_UNNAMED: _Need = (
    "a task whose presses TacVerse does not name",
    lambda config: config.task.name != RecordedTask.grating or not _is_recorded(config),
)
_TABLE: _Need = (
    "a task that TacVerse lists in a table",
    lambda config: config.task.name not in _PRESSED or not _is_recorded(config),
)

#: What each setting needs that does not always have an effect.
_NEEDS: Mapping[str, tuple[_Need, ...]] = {
    "images": (_SELECTS,),
    "spacings_mm": (_GRATING, _SELECTS),
    "pattern": (_GRATING,),
    "classes": (_GRATING,),
    "skip_missing": (_TABLE,),
    "group_pattern": (_RANDOM, _UNNAMED),
    "sensor": (_NAMED,),
    "test_sensor": (_NAMED, _RELEASED),
    "shots": (("data.test_sensor", lambda config: config.data.test_sensor is not None),),
    "split_seed": (
        ("data.split=random or data.shots", lambda config: _is_random(config) or config.data.shots > 0),
        _DEALT,
    ),
    **dict.fromkeys(("validation_part", "test_part"), (_RANDOM, _UNSPLIT)),
}


def with_all_sensors(config: RunConfig, overrides: Sequence[str]) -> RunConfig:
    """Take all sensors that a recording names, where the overrides say what names them, and not which are taken."""
    keys = {override.partition("=")[0] for override in overrides}
    if "data.sensor_column" not in keys or "data.sensor" in keys or config.data.sensor_column is None:
        return config
    return replace(config, data=replace(config.data, sensor=ALL_SENSORS))


def _lacking(name: str, config: RunConfig) -> list[str]:
    """Return what a setting needs that a configuration does not have."""
    return [words for words, holds in _NEEDS.get(name, ()) if not holds(config)]


def are_grouped(data: Mapping[str, Json], task: str) -> bool | None:
    """Answer whether images of some settings of `data` come in groups; None where a file says so, and no setting."""
    source = str(data["source"])
    if source in (DataSource.numpy, DataSource.table):
        return None
    if source == DataSource.tacverse and task == RecordedTask.grating:
        return True
    return source != DataSource.simulated and any(data.get(name) for name in ("group_column", "group_pattern"))


def unused(config: RunConfig) -> frozenset[str]:
    """Return the settings of `data` without effect in a configuration, by their names there."""
    used = {name for name in USED[config.data.source] if not _lacking(name, config)}
    return frozenset(field.name for field in fields(DataConfig)) - used


def check_used(config: RunConfig, composed: Mapping[str, Json], usual: Mapping[str, Json]) -> None:
    """Raise ConfigError where a setting of `data` without effect is not what it is where the user does not set it.

    Both mappings are of these settings by name.
    """
    data = config.data
    for name in sorted(unused(config)):
        if composed.get(name) == usual.get(name):
            continue
        sources = " or ".join(f"data={source}" for source in DataSource if name in USED[source])
        lacking = " and ".join([*([] if name in USED[data.source] else [sources]), *_lacking(name, config)])
        raise ConfigError(
            canonical(composed[name]),
            place=f"data.{name}",
            expected=f"no value without {lacking}: here it has no effect",
            remedy="remove it",
        )
