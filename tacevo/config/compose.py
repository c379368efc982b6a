"""From what a user typed to a checked configuration: the only module that composes with Hydra."""

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import yaml
from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from tacevo.config.ablation import check_change, read_arm, split_arm
from tacevo.config.folder import conf_root, groups
from tacevo.config.keys import expected, keys
from tacevo.config.schema import RunConfig
from tacevo.config.study import StudyConfig
from tacevo.errors import ConfigError
from tacevo.records import Json
from tacevo.storage.canonical import canonical, leaves


def compose(overrides: Sequence[str]) -> RunConfig:
    """Compose a configuration from Hydra overrides such as `experiment=demo` and `seed=3`.

    Raises:
        ConfigError: an unknown key, a value of the wrong type or range, or an unknown choice; the message names
            the key as the user wrote it.
    """
    return cast(RunConfig, _compose(overrides, _RUN))


def spread(overrides: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Write each override as all that it stands for in a sweep: `seed=0,1` becomes `seed=0` and `seed=1`.

    Args:
        overrides: with values of a sweep, where Hydra's multirun takes such: lists, `range(0,5)`, `glob(*)`.

    Returns:
        For each override its values, at least one, each as an override of its own.

    Raises:
        ConfigError: an override cannot be read, or has no end of values.
    """
    _require_settings(overrides)
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(config_dir=str(conf_root()), version_base="1.3", job_name="tacevo"):
            parser = OverridesParser.create(config_loader=GlobalHydra.instance().config_loader())
            return tuple(_values(override) for override in parser.parse_overrides(list(overrides)))
    except ConfigError:
        raise
    except (HydraException, OmegaConfBaseException, ValueError, TypeError) as error:
        raise ConfigError(_explained(error, {})) from error


def _values(override: Override) -> tuple[str, ...]:
    """List the values of one override."""
    written = str(override.input_line)
    if not override.is_sweep_override():
        return (written,)
    if not override.is_discrete_sweep():
        raise ConfigError(f"a sweep needs values that can be counted, as in KEY=1,2 or KEY=range(0,5); got {written!r}")
    values = tuple(f"{override.get_key_element()}={value}" for value in override.sweep_string_iterator())
    if not values:
        raise ConfigError(f"a sweep needs at least one value; {written!r} stands for none")
    return values


def compose_study(overrides: Sequence[str]) -> StudyConfig:
    """Compose the configuration of a study from overrides such as `run=runs/NAME` and `seeds=5`.

    Raises:
        ConfigError: as `compose`.
    """
    return cast(StudyConfig, _compose(overrides, _STUDY))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Root:
    """A file of conf/ that a command composes."""

    #: Of the file.
    name: str
    #: What its `defaults` call the schema.
    schema: str
    type: type
    #: Where a user finds what may be set.
    told: str

    def names(self) -> list[str]:
        """List what a user may set."""
        return [*(groups() if self.type is RunConfig else ()), *keys(self.type)]


_RUN = _Root(name="config", schema="schema", type=RunConfig, told="`tacevo search --help` lists the groups")

_STUDY = _Root(name="study", schema="study_schema", type=StudyConfig, told="`tacevo study --help` lists the settings")


def _compose(overrides: Sequence[str], root: _Root) -> object:
    """Compose a file of conf/ with overrides, into its schema."""
    _require_settings(overrides)
    ConfigStore.instance().store(name=root.schema, node=root.type)
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(config_dir=str(conf_root()), version_base="1.3", job_name="tacevo"):
            if root is _RUN:
                return OmegaConf.to_object(_with_arm(overrides))
            return OmegaConf.to_object(hydra_compose(root.name, overrides=list(overrides)))
    except ConfigError:
        raise
    except (HydraException, OmegaConfBaseException, yaml.YAMLError, OSError, ValueError, TypeError) as error:
        given = dict(override.split("=", 1) for override in overrides)
        raise ConfigError(_explained(error, given, root)) from error


def _with_arm(overrides: Sequence[str]) -> DictConfig:
    """Compose a run, with the arm of an ablation laid over all else that was chosen.

    Hydra itself would let the command line win, as in `ablation=no_prompt_archive prompts=curiosity`, and the arm would
    silently be another one.

    Args:
        overrides: as the user wrote them; one may choose the arm.

    Raises:
        ConfigError: there is no such arm, or the search is the arm's without it.
    """
    choice, others = split_arm(overrides)
    arm = read_arm(choice)
    without = hydra_compose(_RUN.name, overrides=others)
    if not arm:
        return without
    check_change(choice, arm, cast(dict[str, Json], OmegaConf.to_container(without, enum_to_str=True)))
    return cast(DictConfig, OmegaConf.merge(without, arm))


def _require_settings(overrides: Sequence[str]) -> None:
    """Refuse what is no setting of ours.

    Raises:
        ConfigError: a setting is added or removed, is Hydra's own, or has no value.
    """
    added = [override for override in overrides if override.startswith(("+", "~"))]
    if added:
        raise ConfigError(f"every setting has its place already, so none can be added or removed; got {added[0]!r}")
    ignored = [override for override in overrides if override.startswith(("hydra.", "hydra/"))]
    if ignored:
        raise ConfigError(f"Hydra's own settings have no effect here; got {ignored[0]!r}")
    strange = [override for override in overrides if "=" not in override]
    if strange:
        raise ConfigError(f"a setting is written KEY=VALUE or GROUP=CHOICE; got {strange[0]!r}")


def to_plain(config: RunConfig) -> dict[str, Json]:
    """Write a configuration as plain JSON values, enums by their names; `from_plain` reads it back."""
    return cast(dict[str, Json], OmegaConf.to_container(OmegaConf.structured(config), resolve=True, enum_to_str=True))


def from_plain(value: Mapping[str, Json]) -> RunConfig:
    """Read what `to_plain` wrote, and nothing else: each value has one spelling, by which others may tell it.

    Args:
        value: of this version or an earlier one, which lacks the settings that came later.

    Raises:
        ConfigError: the values are no configuration of this version, or are spelt as `to_plain` spells none.
    """
    for key, text in leaves(value):
        if "${" in key or (isinstance(text, str | list) and "${" in str(text)):  # e.g. of a variable of the environment
            raise ConfigError(f"{key} holds ${{...}}, which a recorded configuration never does; restore its file")
    try:
        config = cast(RunConfig, OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(RunConfig), dict(value))))
    except OmegaConfBaseException as error:
        raise ConfigError(_explained(error, dict(leaves(value)))) from error
    written = dict(leaves(to_plain(config)))
    for key, recorded in leaves(value):
        if key not in written or canonical(recorded) != canonical(written[key]):
            raise ConfigError(f"{key} is {recorded!r}, which no recorded configuration has; restore its file")
    return config


def read_named(key: str, name: str) -> str:
    """Read a file that a configuration names, relative to conf/ or absolute."""
    path = conf_root() / name
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{key} names {path}, which cannot be read: {error}") from error


def _explained(error: Exception, given: Mapping[str, object], root: _Root = _RUN) -> str:
    """Say in one line what Hydra or OmegaConf found wrong, and what the user may have meant.

    Args:
        error: theirs.
        given: what the user set, by the key as it was written.
        root: what was composed.
    """
    lines = [line.strip().removeprefix(f"In '{root.name}': ") for line in str(error).splitlines() if line.strip()]
    cause = [line.strip() for line in str(error.__cause__ or "").splitlines() if line.strip()]
    unknown = re.match(r"Could not override '([^']+)'", lines[0])
    if unknown:
        name = unknown.group(1)
        if name in keys(root.type):  # a whole group was set, of which one key is unknown
            name = getattr(error.__cause__, "full_key", name)
        close = difflib.get_close_matches(name, root.names(), n=1)
        meant = f"; did you mean {close[0]!r}?" if close else f"; {root.told}"
        return f"there is no setting {name!r}{meant}"
    if lines[0].startswith("Ambiguous value"):
        several = lines[0].partition("'")[2].rstrip("'")
        return f"{several} stands for several values, and this takes one; `tacevo search -m` runs a search for each"
    misfit = _unchosen(lines[0], given) or _misfit(error, given, root.type)
    if misfit is not None:
        return misfit
    if "Available options in" in str(error):
        start = next(index for index, line in enumerate(lines) if line.startswith("Available options in"))
        options = [line for line in lines[start + 1 :] if not line.startswith(("Config search path", "provider="))]
        return f"{lines[0]}; choose one of {', '.join(options)}"
    if isinstance(error, OverrideParseException):
        return (
            f"the setting {error.override} cannot be read; put a value with special characters in quotes of its own, "
            "as in 'KEY=\"VALUE\"', and write a home folder in full instead of ~"
        )
    return ": ".join([*lines[:1], *cause[:1]])


def _unchosen(line: str, given: Mapping[str, object]) -> str | None:
    """Say what to add where an experiment leaves the choice of the model to the user; else None."""
    if not line.startswith("You must specify 'llm'"):
        return None
    return (
        f"experiment={given.get('experiment')} leaves the choice of the model to you; add llm=anthropic (Claude), "
        "llm=openai llm.model=NAME (a server of yours), or llm=grammar (a control without a language model, whose "
        "results are not a reproduction of the paper's)"
    )


def _misfit(error: Exception, given: Mapping[str, object], schema: type) -> str | None:
    """Say what a key takes and what it got, where the fault is a value that its key cannot hold; else None."""
    fault = error if isinstance(error, OmegaConfBaseException) else error.__cause__
    key = re.sub(r"\[.*", "", getattr(fault, "full_key", None) or "")  # of a list's item, the list
    takes = expected(key, schema) if key else None
    if takes is None:
        return None
    holders = [name for name in given if key == name or key.startswith(f"{name}.")]
    below = [f"{name}={value}" for name, value in given.items() if name.startswith(f"{key}.")]
    got = given[max(holders, key=len)] if holders else " ".join(below) or "nothing"
    return f"{key} needs {takes}; got {got}"
