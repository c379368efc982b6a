"""Arms of an ablation: what each changes, and that it does change it."""

from collections.abc import Mapping, Sequence

import yaml

from tacevo.config.folder import conf_root, groups
from tacevo.errors import ConfigError
from tacevo.records import Json
from tacevo.storage.canonical import leaves

#: The group of the arms, and the one that changes nothing.
GROUP = "ablation"

NONE = "none"


def split_arm(overrides: Sequence[str]) -> tuple[str, list[str]]:
    """Take the choice of an arm out of overrides.

    Args:
        overrides: as a user wrote them, each KEY=VALUE.

    Returns:
        The arm, `none` where none is chosen, and the other overrides.
    """
    choices = [override.partition("=")[2] for override in overrides if override.partition("=")[0] == GROUP]
    others = [override for override in overrides if override.partition("=")[0] != GROUP]
    return (choices[-1].strip("'\"") if choices else NONE), others


def read_arm(choice: str) -> dict[str, Json]:
    """Read what an arm sets, nested as a configuration is; nothing for `none`.

    Raises:
        ConfigError: there is no such arm, or as `parse_arm`.
        OSError: its file cannot be read.
    """
    known = groups()[GROUP]
    if choice not in known:
        raise ConfigError(f"there is no arm {GROUP}={choice}; choose one of {', '.join(known)}")
    return parse_arm(choice, (conf_root() / GROUP / f"{choice}.yaml").read_text(encoding="utf-8"))


def parse_arm(choice: str, text: str) -> dict[str, Json]:
    """Read the text of an arm's file.

    Raises:
        ConfigError: it is no mapping, has Hydra's `defaults`, or is empty and not that of `none`.
    """
    path = f"conf/{GROUP}/{choice}.yaml"
    try:
        settings = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ConfigError(f"{path} is not YAML: {error}") from error
    if not isinstance(settings, dict) or bool(settings) == (choice == NONE):
        due = "the empty mapping, {}" if choice == NONE else "a mapping of what the arm sets, at least one thing"
        raise ConfigError(f"{path} must hold {due}; got {settings!r}")
    if "defaults" in settings:
        raise ConfigError(f"{path} has `defaults`, and an arm is laid over what was chosen: write what it sets instead")
    return settings


def require_change(choice: str, arm: Mapping[str, Json], without: Mapping[str, Json]) -> None:
    """Insist that an arm is no copy of the search without it.

    An arm's first setting is what it is about; the others only follow from it.

    Args:
        choice: its name.
        arm: what it sets, at least one thing.
        without: the whole configuration that it is laid over, plain.

    Raises:
        ConfigError: the search has the arm's first setting already, or has no such setting.
    """
    key, value = next(leaves(arm))
    held: Json = without
    for name in key.split("."):
        if not isinstance(held, Mapping) or name not in held:
            raise ConfigError(
                f"{GROUP}={choice} sets {key}={value}, and there is no such setting; see its file in conf/"
            )
        held = held[name]
    if held == value:
        raise ConfigError(
            f"{GROUP}={choice} sets {key}={value}, which holds here without it, so the arm would be a copy of "
            f"{GROUP}={NONE}; leave this arm out, or choose another {key}"
        )
