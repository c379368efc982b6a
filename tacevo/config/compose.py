"""The composition of a checked configuration from what a user typed; no other module composes with Hydra."""

import contextlib
import copy
import itertools
import re
import shlex
import sys
from collections.abc import Collection, Iterator, Sequence
from dataclasses import MISSING, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, cast

from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.types import Override
from hydra.errors import OverrideParseException
from omegaconf import DictConfig, OmegaConf

from tacevo.choices import ChosenBy, Device
from tacevo.config.arms import check_change, read_arm, split_arm
from tacevo.config.chosen import UNGIVEN, check_parts, name_file, names_open, open_parts
from tacevo.config.composition import composed, laid_over, parsed
from tacevo.config.conf_folder import config_file, config_roots, groups
from tacevo.config.network_files import read_networks
from tacevo.config.own_parts import check_setting, checked, defaults, names_own, own_parts, with_names
from tacevo.config.plain import converted, from_plain, near
from tacevo.config.removed import removed
from tacevo.config.schema import UNCHOSEN, RunConfig, keys
from tacevo.config.sources import DEVICE, check_used, is_elsewhere, is_of_data, unused, with_all_sensors
from tacevo.config.study import NoiseConfig, StudyConfig
from tacevo.errors import ConfigError
from tacevo.records import Json, default_of, to_json
from tacevo.sandbox.part_process import PartProcess
from tacevo.text import as_override, listed, nearest

T = TypeVar("T")

#: The override of a seed that is a number.
_SEED = re.compile(r"seed=(0|[1-9]\d*)")


def _for_device(cpu: Any, cuda: Any, *, _root_: DictConfig) -> Any:
    """Return the first of two defaults for trainings on a CPU, and else the second: on a GPU, or as a study's run says.

    Files of conf/ write `${for_device:FIRST,SECOND}`; what is composed, and recorded, is the value alone.
    """
    return cpu if OmegaConf.select(_root_, "training.device") == Device.cpu.value else cuda


OmegaConf.register_new_resolver("for_device", _for_device, replace=True)


def compose(overrides: Sequence[str]) -> RunConfig:
    """Compose a configuration from Hydra overrides such as `experiment=demo` and `seed=3`.

    The arm of an ablation is laid over all else that was chosen. Hydra itself would let the command line win, as in
    `ablation=no_prompt_archive prompts=curiosity`, and the arm would silently be another one.

    Raises:
        ConfigError: an unknown key, a value of the wrong type or range, an unknown choice, or a setting of data that
            the source does not use; the error's place is the key as the user wrote it. Or the chosen arm changes
            nothing.
    """
    _check_settings(overrides)
    overrides = [each for each in overrides if each != "experiment=null"]  # the default, which Hydra cannot be told
    choice, others = split_arm(overrides)
    arm = dict(read_arm(choice))
    of_arm = arm.pop("parts", None) or {}
    own = [each for each in others if _is_of_parts(each)]
    others = [each for each in others if each not in own]
    with _hydra([*groups(), *keys()], overrides):
        chosen = _composed("config", others)
        if arm:
            check_change(choice, arm, _plain(chosen))
            chosen = cast(DictConfig, OmegaConf.merge(chosen, arm))
        plain = _with_own_parts(_plain(chosen), own, cast(dict[str, Any], of_arm))
        config = _with_prices_here(from_plain(plain), overrides)
        check_parts(config)
        without = [each for each in others if not _names_any(each, unused(config))]
        if len(without) < len(others) or "data" in arm:
            used = _plain(chosen.data)
            check_used(config, used, _plain(_composed("config", without).data))
    return with_all_sensors(_counting_networks(config, others), others)


def _counting_networks(config: RunConfig, overrides: Sequence[str]) -> RunConfig:
    """Return a configuration whose `search.initial` is the number of networks that it gives, where it gives some.

    Raises:
        ConfigError: the user set another number.
    """
    if not config.search.networks:
        return config
    given = read_networks(config.search.networks, "search.networks")
    if config.search.initial != len(given) and any(each.startswith("search.initial=") for each in overrides):
        expected = f"{len(given)}, the number of networks of search.networks, or nothing"
        raise ConfigError(str(config.search.initial), place="search.initial", expected=expected)
    return replace(config, search=replace(config.search, initial=len(given)))


def _is_of_parts(override: str) -> bool:
    return override.startswith("parts.")


def _with_own_parts(plain: dict[str, Json], overrides: Sequence[str], arm: dict[str, Any]) -> dict[str, Json]:
    """Return a configuration with the parts that its user brought: their code, and their settings.

    Those are composed by Hydra over the defaults that each part states; overrides of parts that are not chosen here,
    but are installed, have no effect, so that a sweep can set what one of its arms has.
    """
    given = {**cast(dict[str, Any], plain.get("parts") or {}), **arm}
    if not (overrides or given or names_own(plain) or names_open(plain)):
        return plain
    with PartProcess() as process:
        return _laid_over_parts(plain, overrides, given, process)


def _laid_over_parts(
    plain: dict[str, Json], overrides: Sequence[str], given: dict[str, Any], process: PartProcess
) -> dict[str, Json]:
    """Return a configuration with the code and settings of its user's parts; they say in `process` what they take."""
    found, others = own_parts(plain, process), [part for part in open_parts(plain) if part.settings]
    named = [*(part.name for part in found), *(part.name for part in others)]
    chosen = set(named)
    if len(chosen) < len(named):
        got = listed(named)
        raise ConfigError(got, place="parts", expected="parts of different names, each of which has settings")
    for override in overrides:
        name, _, setting = override.partition("=")[0].removeprefix("parts.").partition(".")
        check_setting((*found, *others), name, setting)
    laid = [each for each in overrides if each.partition("=")[0].split(".")[1] in chosen]
    # Defaults are data of a part, and no text for OmegaConf, which would resolve what stands in `${...}`.
    usual: dict[str, dict[str, Any]] = {part.name: dict(part.settings) for part in others}
    usual |= cast(dict[str, dict[str, Any]], defaults(found))
    unset = {name: {setting: None for setting in values} for name, values in usual.items()}
    given_here = cast(dict[str, Any], _plain(laid_over({"parts": unset}, laid))["parts"])
    settings: dict[str, dict[str, Any]] = {}
    for name, values in usual.items():
        of_files = given.get(name) or {}
        for setting in of_files:
            check_setting((*found, *others), name, setting)
        said = {**values, **of_files, **{key: value for key, value in given_here[name].items() if value is not None}}
        lacking = next((key for key, value in said.items() if value == UNGIVEN), None)
        if lacking is not None:
            raise ConfigError("nothing", place=f"parts.{name}.{lacking}", expected="a value: it has no default")
        settings[name] = said
    outer: dict[str, Json] = {part.name: settings[part.name] for part in others}
    return {**with_names(plain, found), "parts": {**checked(found, settings, process), **outer}}


def _with_prices_here(config: RunConfig, overrides: Sequence[str]) -> RunConfig:
    """Return a configuration whose price table, where a user names one that lies in the working directory, is that."""
    here = Path(config.llm.prices).expanduser()
    if not here.is_file() or not any(each.startswith("llm.prices=") for each in overrides):
        return config
    return replace(config, llm=replace(config.llm, prices=str(here.absolute())))


def compose_estimate(overrides: Sequence[str]) -> RunConfig:
    """Compose what an estimate is of, as `compose`; a model that is not chosen is called `UNCHOSEN`.

    Raises:
        ConfigError: as `compose`, but for a missing model.
    """
    chosen = {override.partition("=")[0] for override in overrides}
    try:
        return compose(overrides)
    except ConfigError as error:
        if error.place not in {"llm", "llm.model"} - chosen:
            raise
    missing = {"llm": "openai", "llm.model": f"'{UNCHOSEN}'"}
    return compose([*overrides, *(f"{key}={value}" for key, value in missing.items() if key not in chosen)])


def compose_study(overrides: Sequence[str], *, given: bool = False) -> StudyConfig:
    """Compose the configuration of a study from overrides such as `run=runs/NAME`.

    A study of given networks, or of a baseline alone, names neither a run nor a sweep (`given`); that of a sweep's jobs
    has one elite of each unless it says more.

    Raises:
        ConfigError: as `compose`; or not exactly one of run, sweep and networks is named; or a plan beside a sweep, or
            arms without one; or one elite is to be chosen among fewer than two.
    """
    config = _compose_command("study", StudyConfig, [*map(_as_list, overrides)])
    named = {"run": config.run, "sweep": config.sweep, "networks": ", ".join(config.networks)}
    several = [name for name, value in named.items() if value]
    if len(several) > 1 or not (several or given):
        got = " and ".join(f"{name}={named[name]}" for name in several) or "none"
        expected = "the directory of a finished run, as in run=runs/NAME, or in its place sweep= or networks="
        remedy = "for a baseline alone, name a task, as in task=hardness"
        raise ConfigError(got, place="run", expected=expected, remedy=remedy)
    if config.sweep is not None and not any(override.startswith("elites=") for override in overrides):
        config = replace(config, elites=1)
    if config.choose is ChosenBy.validated and config.elites < 2:
        expected = "at least 2 with choose=validated, which takes one of them"
        raise ConfigError(str(config.elites), place="elites", expected=expected)
    if config.sweep is None:
        if config.arms:
            raise ConfigError(listed(config.arms), place="arms", expected="no value without sweep=")
        return config
    if config.plan is not None:
        remedy = "a sweep states its plan when it begins: `tacevo search -m ... --plan FILE`"
        raise ConfigError(config.plan, place="plan", expected="no value with sweep=", remedy=remedy)
    return config


def compose_elsewhere(config: RunConfig, overrides: Sequence[str]) -> RunConfig:
    """Lay settings of other data, numerics or another device over the configuration of a run.

    Another source of data brings what its file sets, and its split; another device all that is set for it; else the
    run's settings hold. Only the overrides are composed: OmegaConf would resolve `${...}` in the text of a recorded
    run, which may be a stranger's.

    Raises:
        ConfigError: as `compose`; or it sets anything else; or the images would have another size than the run's
            networks are for.
    """
    _check_settings(overrides)
    for override in overrides:
        if not is_elsewhere(override):
            expected = f"settings of data, or {', '.join(DEVICE)}: all others are the run's"
            raise ConfigError(override, place=override.partition("=")[0], expected=expected)
    of_data = [override for override in overrides if is_of_data(override)]
    for override in of_data:
        if override.startswith("data.source="):
            name_file(override.partition("=")[2].strip("'\""))
    on = [override for override in overrides if override not in of_data]
    config = _on_device(config, on) if on else config
    return _with_data(config, of_data) if of_data else config


def _on_device(config: RunConfig, overrides: Sequence[str]) -> RunConfig:
    with _hydra([*groups(), *keys()], overrides, "study"):
        laid: dict[str, Any] = {**_plain(_composed("config", overrides))}
    named = {override.partition("=")[0] for override in overrides}
    if laid["training"]["device"] != config.training.device and "training.device" in named:
        named |= {key for key in DEVICE if key.startswith("training.")}
    plain = cast(dict[str, Any], to_json(config))
    for group, _, name in (key.partition(".") for key in named):
        plain[group] = {**plain[group], **({name: laid[group][name]} if name else laid[group])}
    return from_plain(plain)


def _with_data(config: RunConfig, overrides: Sequence[str]) -> RunConfig:
    choices = [override for override in overrides if override.startswith("data=")]
    with _hydra([*groups(), *keys()], overrides, "study"):
        usual, chosen, laid = (_plain(_composed("config", each).data) for each in ([], choices, overrides))
    split = {"split", "validation_part", "test_part"} if chosen["source"] != config.data.source else set()
    brought = {key for key in chosen if choices and (key in {"source", *split} or chosen[key] != usual[key])}
    named = {override.partition("=")[0].removeprefix("data.") for override in overrides} & laid.keys()
    own = {key: laid[key] for key in brought | named}
    other = from_plain({**to_json(config), "data": {**to_json(config.data), **own}})
    check_used(other, {**chosen, **{key: laid[key] for key in named}}, chosen)
    if other.data.image_size != config.data.image_size:
        expected = f"{config.data.image_size}, which the run's networks are for"
        raise ConfigError(str(other.data.image_size), place="data.image_size", expected=expected)
    return with_all_sensors(other, overrides)


def compose_noise(overrides: Sequence[str]) -> NoiseConfig:
    """Compose the configuration of a noise run from overrides such as `seeds=5`.

    Raises:
        ConfigError: as `compose`, or it does not name either a run or a sweep.
    """
    config = _compose_command("noise", NoiseConfig, overrides)
    if (config.run is None) == (config.sweep is None):
        expected = "the directory of a finished run, as in run=runs/NAME, or that of a sweep, as in sweep=sweeps/NAME"
        got = "neither run= nor sweep=" if config.run is None else f"both run={config.run} and sweep={config.sweep}"
        raise ConfigError(got, place="run", expected=expected)
    return config


def _compose_command(command: str, kind: type[T], overrides: Sequence[str]) -> T:
    """Compose the settings of a command from its own file in conf/."""
    _check_settings(overrides)
    with _hydra(keys(kind), overrides, command):
        plain = _plain(_composed(command, overrides))
    return converted(kind, plain)


def _composed(name: str, overrides: Sequence[str]) -> DictConfig:
    """Let Hydra compose a file of conf/; choices are looked up in the user's own directory of configs, too.

    Raises:
        ConfigError: tacevo and the user have different files for a choice.
    """
    seeds = [override for override in overrides if _SEED.fullmatch(override)]
    # One seed stands for all others: a sweep composes once for an arm.
    alike = ["seed=0" if override in seeds else override for override in overrides]
    config, choices = composed(name, alike if len(seeds) == 1 else overrides, config_roots())
    for group, choice in choices.items():
        config_file(f"{group}/{choice}.yaml", group)
    if len(seeds) == 1:
        config = copy.deepcopy(config)  # what was composed is kept, for other seeds
        config.seed = int(seeds[0].partition("=")[2])  # as Hydra does, after all files and before `${seed}` is read
    return config


def spread(overrides: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Write each override as all that it stands for in a sweep: `seed=0,1` becomes `seed=0` and `seed=1`.

    Args:
        overrides: with values of a sweep, where Hydra's multirun takes such: lists, `range(0,5)`, `glob(*)`.

    Returns:
        For each override its values, at least one, each as an override of its own.

    Raises:
        ConfigError: an override cannot be read, or does not stand for a finite number of values.
    """
    _check_settings(overrides)
    with _hydra([*groups(), *keys()], overrides):
        return tuple(map(_values, parsed(overrides, config_roots())))


def _as_list(override: str) -> str:
    """Write the arms of a study, which a user separates by commas, as Hydra writes a list of texts."""
    key, _, value = override.partition("=")
    if key != "arms" or value.startswith("["):
        return override
    names = [as_override("", part.strip("'\"")).removeprefix("=") for part in value.split(",")]
    return f"arms=[{','.join(names)}]"


def _names_any(override: str, settings: Collection[str]) -> bool:
    """Answer whether an override sets one of these settings of data, or all of them at once."""
    key, _, value = override.partition("=")
    if key == "data":
        return value.lstrip().startswith("{")
    return key.startswith("data.") and key.removeprefix("data.") in settings


def _plain(composed: DictConfig) -> dict[str, Json]:
    return cast(dict[str, Json], OmegaConf.to_container(composed, resolve=True, throw_on_missing=True))


def _defaults(schema: type) -> dict[str, Json]:
    """Return what a schema's settings are where the files of conf/ leave them out."""
    defaults = ((field.name, default_of(field)) for field in fields(schema))
    given = {name: to_json(default) for name, default in defaults if default is not MISSING}
    return given | {
        field.name: _defaults(field.type)
        for field in fields(schema)
        if isinstance(field.type, type) and is_dataclass(field.type)
    }


def _check_settings(overrides: Sequence[str]) -> None:
    """Refuse what is not a setting of tacevo: what is added or removed, is Hydra's own, or lacks a value."""
    for override, after in itertools.pairwise([*overrides, ""]):
        if override.startswith("parts="):
            expected = "parts.NAME.SETTING=VALUE, a setting of a part"
            raise ConfigError(override, place="parts", expected=expected)
        expected = "KEY=VALUE or GROUP=CHOICE"
        if override.startswith(("+", "~", "hydra.", "hydra/", "code=", "code.")):
            remedy = "settings cannot be added or removed, and Hydra's own have no effect"
            raise ConfigError(repr(override), expected=expected, remedy=remedy)
        is_torn = override.endswith("=") and after != "" and "=" not in after
        if "=" not in override.lstrip("=") or is_torn:
            raise ConfigError(repr(override), expected=expected, remedy=_spaced(override, overrides))


def _spaced(word: str, words: Sequence[str]) -> str:
    """Say what to do with a word that is no setting by itself: most were torn off one by a space."""
    place = list(words).index(word)
    before, after = words[place - 1] if place else "", [*words[place + 1 :], ""][0]
    if before.endswith((",", "[", "{", "(")) or word.startswith((",", "]", "}", ")")):
        return f"no space after the comma or within brackets: {shlex.quote(f'{before}{word}')}"
    if word.endswith("=") or after.startswith("=") or word == "=":
        return "no space beside the equals sign"
    known = {*groups(), *keys()}
    key, _, value = word.partition(":")
    if key in known:
        return f"write {key}={value or after or 'VALUE'}"
    if chosen := [group for group, choices in groups().items() if word in choices]:
        return f"did you mean {chosen[0] if 'experiment' not in chosen else 'experiment'}={word}?"
    return nearest(key, known, "a setting is written with an equals sign, as in seed=3", before="a value of ")


def _values(override: Override) -> tuple[str, ...]:
    """List the values of one override."""
    written = str(override.input_line)
    if not override.is_sweep_override():
        return (written,)
    counted = override.is_discrete_sweep()
    values = tuple(override.sweep_string_iterator()) if counted else ()
    if not values:
        expected = "one value or more that can be counted, as in KEY=1,2 or KEY=range(0,5)"
        raise ConfigError(written, place="a sweep", expected=expected)
    return tuple(f"{override.get_key_element()}={value}" for value in values)


@contextlib.contextmanager
def _hydra(names: Sequence[str], overrides: Sequence[str], command: str = "search") -> Iterator[None]:
    """Let Hydra read the configs, and turn what it raises into an error in the user's words."""
    if sys.flags.optimize:  # some assertions of its parser step over a token
        remedy = "unset it, and leave out -O: Hydra reads settings by assertions"
        raise ConfigError(str(sys.flags.optimize), place="PYTHONOPTIMIZE", expected="no value", remedy=remedy)
    ConfigStore.instance().store(name="schema", node=_defaults(RunConfig))
    try:
        yield
    except ConfigError:
        raise
    except OverrideParseException as error:
        raise _unread(error, names, command) from error
    except Exception as error:  # of Hydra, OmegaConf, YAML or the file system, which share no class
        raise _explained(error, names, overrides, command) from error


def _explained(error: Exception, names: Sequence[str], overrides: Sequence[str], command: str) -> ConfigError:
    """Return the error in words of ours for a wrong name and a missing model, else in Hydra's or OmegaConf's own."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()] or [type(error).__name__]
    unknown = re.match(r"Could not override '([^']+)'", lines[0])
    if unknown:
        # The cause names the key of a group that was set as a whole.
        name = max(unknown.group(1), getattr(error.__cause__, "full_key", None) or "", key=len)
        return removed(name) or ConfigError("not a setting", place=name, remedy=near(name, names, command))
    several = re.match(r"(?:Ambiguous value for argument|Sweep parameters) '(.*)'", lines[0])
    if several:
        each = "`tacevo search -m ...` runs a sweep of all values" if command == "search" else "call it for each"
        return ConfigError(
            several.group(1),
            expected="one value: this runs once",
            remedy=f"{each}; a list is written KEY=[A,B]",
        )
    if lines[0].startswith("You must specify 'llm'"):
        experiment = dict(override.split("=", 1) for override in overrides).get("experiment")
        return ConfigError(
            f"experiment={experiment} leaves the choice of the model to you",
            place="llm",
            remedy="add llm=anthropic (Claude), llm=openai llm.model=NAME (a server of yours), or llm=grammar (a "
            "control without a language model, whose results are not a reproduction of the paper's); the model must "
            "take a temperature: experiment=paper_today has one of today, which takes none",
        )
    said = [*itertools.takewhile(lambda line: not line.startswith("Config search path"), lines)]
    missing = re.search(r"Could not find '(.+)/([^/]*)'", said[0])
    if missing:
        group, choice = missing.groups()
        known = ", ".join(said[2:])
        remedy = nearest(choice, known.split(", "), "")
        return removed(f"{group}={choice}") or ConfigError(
            choice, place=group, expected=f"one of {known}", remedy=remedy
        )
    return ConfigError(" ".join(said), place=getattr(error, "full_key", None) or "")


def _unread(error: OverrideParseException, names: Sequence[str], command: str) -> ConfigError:
    """Return the error for a setting whose name or value is beyond Hydra's grammar."""
    key, _, value = error.override.partition("=")
    if key not in names:
        return ConfigError("not a setting", place=key, remedy=near(key, names, command))
    lines = str(error).splitlines()
    why = lines[lines[0].startswith("Error parsing override")]  # it may repeat the setting first
    remedy = f"Hydra says: {why}; for a text, write {shlex.quote(as_override(key, value))}"
    return ConfigError(value, place=key, expected="a value that Hydra can read", remedy=remedy)
