"""A configuration read from plain JSON values, as run.json keeps it; it composes nothing, so it needs no Hydra."""

import re
from collections.abc import Mapping, Sequence
from typing import TypeVar

from tacevo.config.checks import check_together
from tacevo.config.removed import without_removed
from tacevo.config.schema import RunConfig, keys
from tacevo.errors import ConfigError
from tacevo.records import Json
from tacevo.text import listed, nearest
from tacevo.typed import convert

#: What some write for the numbers from one to another, such as `0-3` and `0..3`.
_RANGE = re.compile(r"^\W*(\d{1,9})\s*(?:-|:|\.{2,3}|to)\s*(\d{1,9})\W*$")

T = TypeVar("T")


def from_plain(value: Mapping[str, Json]) -> RunConfig:
    """Read what `to_json` wrote, in this version or an earlier one.

    An earlier one lacks the settings that came later, and may have some that were removed (`tacevo.config.removed`).

    Raises:
        ConfigError: the values are not a configuration of this version.
    """
    config = converted(RunConfig, without_removed(value))
    check_together(config)
    return config


def converted(kind: type[T], plain: Json) -> T:
    """Read the settings of a run, a study or a noise run, each by itself.

    Raises:
        ConfigError: the first value that is not one of its setting; the place is the key.
    """
    try:
        return convert(kind, plain, place="", error=ConfigError)
    except ConfigError as error:
        if error.expected == "text":
            error.remedy = "put it in quotes, as in 'run.dir=\"5\"' or 'data.target_columns=[\"5\"]'"
        elif kind is RunConfig and error.expected.startswith("an integer") and (ends := _RANGE.search(error.got)):
            first, last = map(int, ends.groups())
            error.remedy = f"a range is '{error.place}=range({first},{last + 1})', which a sweep takes (-m)"
        elif error.expected == "an object":  # a value for what only holds settings
            known = keys(kind)
            within = [key for key in known if key.startswith(f"{error.place}.")]
            settings = [key for key in within if not any(other.startswith(f"{key}.") for other in known)]
            error.expected, error.remedy = "settings of its own", f"set {' or '.join(settings)}"
        elif error.expected.startswith("only keys"):  # a file of conf/ misspells one
            error.remedy = near(error.place, keys(kind))
        raise


def near(name: str, names: Sequence[str], command: str = "search") -> str:
    """Return the remedy for a name that is not one of these: the closest one, or else the help of a command.

    Within a group that is the closest of its settings, or else all of them.
    """
    group, _, setting = name.rpartition(".")
    within = [key.removeprefix(f"{group}.") for key in names if group and key.rpartition(".")[0] == group]
    if not within:
        return nearest(name, names, f"`tacevo {command} --help` lists the settings")
    every = listed(f"{group}.{key}" for key in within)
    return nearest(setting, within, f"the settings of {group} are {every}", before=f"{group}.")
