"""Arms of an ablation: what each changes, and the check that it does."""

from collections.abc import Mapping, Sequence

import yaml

from tacevo.config.conf_folder import config_file, groups
from tacevo.config.removed import removed
from tacevo.config.strict_yaml import read_yaml
from tacevo.errors import ConfigError
from tacevo.records import Json
from tacevo.storage.canonical import leaves
from tacevo.text import nearest

#: The group of the arms, and the one that changes nothing.
GROUP = "ablation"

NONE = "none"


def split_arm(overrides: Sequence[str]) -> tuple[str, list[str]]:
    """Return the arm that overrides choose, `none` if they choose none, and the other overrides."""
    pairs = [override.partition("=") for override in overrides]
    choices = [value for key, _, value in pairs if key == GROUP]
    others = ["".join(pair) for pair in pairs if pair[0] != GROUP]
    return (choices[-1].strip("'\"") if choices else NONE), others


def read_arm(choice: str) -> dict[str, Json]:
    """Read what an arm sets, nested as a configuration is; nothing for `none`.

    Raises:
        ConfigError: the arm does not exist, or as `parse_arm`.
        OSError: its file cannot be read.
    """
    known = groups()[GROUP]
    if choice not in known:
        expected, remedy = f"one of {', '.join(known)}", nearest(choice, known, "")
        raise removed(f"{GROUP}={choice}") or ConfigError(repr(choice), place=GROUP, expected=expected, remedy=remedy)
    return parse_arm(choice, config_file(f"{GROUP}/{choice}.yaml", GROUP).read_text(encoding="utf-8"))


def parse_arm(choice: str, text: str) -> dict[str, Json]:
    """Read the text of an arm's file.

    Raises:
        ConfigError: it is not a mapping, has Hydra's `defaults`, or is empty and not that of `none`.
    """
    path = f"conf/{GROUP}/{choice}.yaml"
    try:
        settings = read_yaml(text)
    except yaml.YAMLError as error:
        raise ConfigError(str(error), place=path, expected="YAML") from error
    if not isinstance(settings, dict) or bool(settings) == (choice == NONE):
        expected = "the empty mapping, {}" if choice == NONE else "a mapping of at least one setting"
        raise ConfigError(repr(settings), place=path, expected=expected)
    if "defaults" in settings:
        remedy = "write what `defaults` would set: an arm is laid over what was chosen"
        raise ConfigError("`defaults`", place=path, expected="settings", remedy=remedy)
    return settings


def check_change(choice: str, arm: Mapping[str, Json], without: Mapping[str, Json]) -> None:
    """Check that an arm is not a copy of the search without it, given as the whole configuration.

    An arm's first setting is what it is about; the others only follow from it.

    Raises:
        ConfigError: the search has the arm's first setting already, or does not know the setting.
    """
    key, value = next(leaves(arm))
    settings = dict(leaves(without))
    place = f"{GROUP}={choice}"
    if key not in settings:
        raise removed(f"{key}={value}") or ConfigError(
            f"{key}={value}, which is not a setting", place=place, expected="a setting of a search"
        )
    if settings[key] == value:
        expected, remedy = (
            f"a change: else it is a copy of {GROUP}={NONE}",
            f"leave this arm out, or choose another {key}",
        )
        raise ConfigError(f"{key}={value} in the search without it, too", place=place, expected=expected, remedy=remedy)
