"""Remove the settings of one machine (paths, server addresses, trackers) from a configuration that is published; pure.

Paths keep their last part, so that a reader sees which file it was.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePath

from tacevo.config.recorded_parts import DECIDING
from tacevo.config.schema import DataConfig, RunConfig
from tacevo.errors import ConfigError
from tacevo.records import Json, to_json
from tacevo.redaction import names_place

#: Stands for a directory without a name of its own, such as `.`.
_NAMELESS = "data"

#: Groups of overrides that say where a run lies, or what tracks it.
_ELSEWHERE = ("run.", "store.", "tracking.")


def last_part(path: str) -> str:
    """Return the last part of a path."""
    name = PurePath(path).name
    return _NAMELESS if name in {"", ".."} else name


def relative(path: str) -> str:
    """Return an absolute path's last part; another path as it is, for it says nothing of the machine."""
    return last_part(path) if PurePath(path).is_absolute() else path


def _named(value: str) -> str:
    """Return the names of parts, of each FILE.py:CLASS the class, as run.json has them."""
    return re.sub(r"[^\s,\[\]'\"]+\.py\\?:(\w+)", r"\1", value)


def _each_relative(value: str) -> str:
    """Shorten each path of a list as a user writes it, such as `[nets/*.py,/home/me/one.py]`."""
    return re.sub(r"[^\[\],'\"]+", lambda path: relative(path[0]), value)


#: Settings that are paths, with the function that shortens each for publication.
_PATHS: Mapping[str, Callable[[str], str]] = {
    **{kind.setting: _named for kind in DECIDING},
    "data.root": last_part,
    **dict.fromkeys(("data.source", "llm.provider", "executor.kind"), relative),  # of a part, FILE.py:CLASS
    "data.table": relative,
    "data.sensor": relative,
    "data.pattern": relative,
    "llm.prices": last_part,
    "search.networks": _each_relative,
    "task.baseline": relative,
    "task.instructions": relative,
    "task.system": relative,
}


#: The published values of settings that say where a run lies, or what tracks it.
_ANYWHERE: Mapping[str, Mapping[str, Json]] = {
    "llm": {"base_url": None},
    "tracking": {"kind": "none", "uri": ""},
    "store": {"root": "cache"},
    "run": {"dir": None},
}


def published_config(config: Mapping[str, Json]) -> dict[str, Json]:
    """Return a run's configuration, as in run.json, without what belongs to one machine."""
    published = dict(config)
    for group in (*config, "run"):  # which an early run lacks
        settings = config.get(group, {})
        if isinstance(settings, Mapping):
            shortened = {name: _shortened(f"{group}.{name}", value) for name, value in settings.items()}
            named = {"model": settings["label"]} if group == "llm" and settings.get("label") else {}
            published[group] = {**shortened, **_ANYWHERE.get(group, {}), **named}
    return published


def check_name(model: str) -> None:
    """Check that the name of a model, which is published, tells nothing of a machine.

    Raises:
        ConfigError: it is a path of this machine, or an address.
    """
    if names_place(model):
        raise ConfigError(
            model,
            place="the model's name",
            expected="one that is not a path of this machine",
            remedy="repeat the search with llm.label=NAME, and publish that run: recorded answers are not asked again",
        )


def other_settings(own: DataConfig, other: DataConfig) -> tuple[tuple[str, Json], ...]:
    """Return (name, value) of the settings of data that differ from a run's, as they are published.

    The place of the data is left out: it is that of one machine, and the data may move.
    """
    before, after = to_json(own), to_json(other)
    return tuple(
        (name, _shortened(f"data.{name}", value))
        for name, value in after.items()
        if name != "root" and value != before[name]
    )


def other_device(own: RunConfig, other: RunConfig, *, eager: bool = False) -> tuple[tuple[str, Json], ...]:
    """Return (name, value) of the settings that decide the bits of a training, and differ from a run's.

    With `eager`, under rules that ran every step eagerly, whether steps are captured is not such a setting.
    """
    before, after = to_json(own.training), to_json(other.training)
    names = [
        name
        for name in ("device", "gpu", "precision", "gpu_memory_mib", "layout", "captured")
        if after[name] != before[name] and not (eager and name == "captured")
    ]
    numerics = () if other.numerics == own.numerics else (("numerics", other.numerics.kind.value),)
    return (*numerics, *((f"training.{name}", after[name]) for name in names))


def _shortened(key: str, value: Json) -> Json:
    if isinstance(value, list | tuple):
        return [_shortened(key, each) for each in value]
    return _PATHS[key](value) if key in _PATHS and isinstance(value, str) else value


def published_overrides(overrides: Sequence[str]) -> tuple[str, ...]:
    """Return a sweep's overrides without what belongs to one machine; they compose what `published_config` returns.

    Raises:
        ConfigError: an override sets a whole group, in which a path cannot be found.
    """
    for override in overrides:
        key, _, value = override.partition("=")
        if value.lstrip().startswith("{") and "." not in key:
            raise ConfigError(
                f"{override}, which sets a whole group, so a path inside it cannot be removed",
                expected="a sweep with one override per setting",
                remedy=f"start the sweep again with {key}.NAME=VALUE",
            )
    kept = (_published(override) for override in overrides)
    return tuple(override for override in kept if override is not None)


def _published(override: str) -> str | None:
    key, _, value = override.partition("=")
    if key.startswith(_ELSEWHERE) or key == "llm.base_url":
        return None
    bare = value.strip("'\"")
    shortened = last_part if key == "llm.model" and names_place(bare) else _PATHS.get(key)
    if shortened is None or bare == "null":
        return override
    quote = value[: value.index(bare)] if bare else ""
    return f"{key}={quote}{shortened(bare)}{quote}"
