"""The settings of `data` that each source uses (others are refused), and those that a study has of its own."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace

from tacevo.choices import ALL_SENSORS, RecordedTask, SplitRule
from tacevo.config.schema import DataConfig, RunConfig
from tacevo.errors import ConfigError
from tacevo.parts.facts import EVERY_SOURCE, source_facts
from tacevo.parts.kinds import SOURCES
from tacevo.parts.registry import find
from tacevo.records import Json
from tacevo.storage.canonical import canonical

#: The settings, beside data, that a study may have for its trainings other than its run's.
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


#: Tasks whose images TacVerse does not list in a table.
_PRESSED = (RecordedTask.grating, RecordedTask.shape)


def _is_random(config: RunConfig) -> bool:
    return config.data.split is SplitRule.random


def _is_release(config: RunConfig) -> bool:
    return config.data.facts.is_release


#: A condition of a setting beside its source, in words and as a rule.
_Need = tuple[str, Callable[[RunConfig], bool]]

_NAMED: _Need = (
    "data.sensor_column",
    lambda config: not config.data.facts.names_sensors or config.data.sensor_column is not None,
)
_RELEASED: _Need = ("data.split=release", lambda config: not _is_release(config) or not _is_random(config))
_GRATING: _Need = ("task=grating", lambda config: config.task.name == RecordedTask.grating)
_SELECTS: _Need = ("data.select=true", lambda config: config.data.select or not _is_release(config))
_RANDOM: _Need = ("data.split=random", _is_random)
_DEALT: _Need = (
    "data.split_column=null, or data.shots",
    lambda config: config.data.split_column is None or config.data.shots > 0,
)
_UNSPLIT: _Need = ("data.split_column=null", lambda config: config.data.split_column is None)
_UNNAMED: _Need = (
    "a task whose presses TacVerse does not name",
    lambda config: config.task.name != RecordedTask.grating or not _is_release(config),
)
_TABLE: _Need = (
    "a task that TacVerse lists in a table",
    lambda config: config.task.name not in _PRESSED or not _is_release(config),
)

#: The conditions of each setting that does not always have an effect.
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
    facts = source_facts(str(data["source"]))
    if facts.has_groups:
        return None
    if facts.is_release and task == RecordedTask.grating:
        return True
    return not facts.is_made and any(data.get(name) for name in ("group_column", "group_pattern"))


def used_by(source: str) -> frozenset[str]:
    """Return the settings of `data` that a source uses: of one that is not ours, the fields of its class.

    Raises:
        ConfigError: it cannot be imported.
    """
    part = find(SOURCES, source)
    if part.is_ours:
        return source_facts(source).uses
    return EVERY_SOURCE | frozenset(getattr(part.load(), "__dataclass_fields__", ()))


def unused(config: RunConfig) -> frozenset[str]:
    """Return the settings of `data` without effect in a configuration, by their names there."""
    used = {name for name in used_by(config.data.source) if not _lacking(name, config)}
    return frozenset(field.name for field in fields(DataConfig)) - used


def check_used(config: RunConfig, composed: Mapping[str, Json], usual: Mapping[str, Json]) -> None:
    """Raise ConfigError where a setting of `data` without effect is not what it is where the user does not set it.

    Both mappings are of these settings by name.
    """
    data = config.data
    for name in sorted(unused(config)):
        if composed.get(name) == usual.get(name):
            continue
        sources = " or ".join(f"data={source}" for source in SOURCES.ours if name in source_facts(source).uses)
        lacking = " and ".join([*([] if name in used_by(data.source) else [sources]), *_lacking(name, config)])
        raise ConfigError(
            canonical(composed[name]),
            place=f"data.{name}",
            expected=f"no value without {lacking}: here it has no effect",
            remedy="remove it",
        )
