"""Arms of an ablation: what each changes, and that it does change it."""

from collections.abc import Iterator, Mapping, Sequence

import yaml

from tacevo.confdir import conf_root
from tacevo.errors import ConfigError
from tacevo.records import Json

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
        OSError: there is no such arm.
    """
    text = (conf_root() / GROUP / f"{choice}.yaml").read_text(encoding="utf-8")
    settings: dict[str, Json] = yaml.safe_load(text)
    return settings


def require_change(choice: str, arm: Mapping[str, Json], without: Mapping[str, Json]) -> None:
    """Insist that an arm is no copy of the search without it.

    An arm's first setting is what it is about; the others only follow from it.

    Args:
        choice: its name.
        arm: what it sets, at least one thing.
        without: the whole configuration that it is laid over, plain.

    Raises:
        ConfigError: the search has the arm's first setting already.
    """
    key, value = next(_flat(arm))
    held: Json = without
    for name in key.split("."):
        held = held[name]
    if held == value:
        raise ConfigError(
            f"{GROUP}={choice} sets {key}={value}, which holds here without it, so the arm would be a copy of "
            f"{GROUP}={NONE}; leave this arm out, or choose another {key}"
        )


def _flat(value: Mapping[str, Json], prefix: str = "") -> Iterator[tuple[str, Json]]:
    """Walk nested settings by their whole keys, e.g. `prompts.policy`."""
    for name, inner in value.items():
        if isinstance(inner, Mapping):
            yield from _flat(inner, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", inner
