"""The command `tacevo parts`: what there is, and whether a part keeps its contracts."""

import inspect
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from tacevo.cli.common import DIFFERENT, DONE, tell
from tacevo.cli.signature import Command
from tacevo.config.chosen import part_of
from tacevo.config.compose import compose
from tacevo.config.schema import RunConfig
from tacevo.errors import ConfigError, PartError, TacevoError
from tacevo.parts.kinds import KINDS, OUTPUTS, Kind
from tacevo.parts.known import first_line_of, lacking
from tacevo.parts.registry import Part, ambiguous, find, import_file, names, parts, shadowed
from tacevo.parts.testing import contracts, kind_of
from tacevo.text import assignments, listed, nearest

#: A file, all of whose parts are checked, or one of them.
_FILE = re.compile(r"(?P<file>.+\.py)(:(?P<name>\w+))?")

#: A part as a search names it: `proposals.parents=lexicase`.
_CHOSEN = re.compile(r"(?P<setting>[a-z]+\.[a-z]+)=(?P<name>.+)")


def run_parts(kind: str | None, part: str | None, overrides: Sequence[str], commands: Mapping[str, str]) -> int:
    """List the parts of all kinds or of one, or check a part; `commands` are the lines of ours by name."""
    if kind == "check":
        if part is None:
            raise ConfigError(
                "nothing", place="tacevo parts check", expected="the name of a part, or a file with parts"
            )
        return _check(part, overrides)
    if part is not None or kind not in {None, *KINDS}:
        got = str(kind) if part is None else f"{kind} {part}"
        remedy = nearest(str(kind), ["check", *KINDS], "")
        raise ConfigError(got, place="tacevo parts", expected=f"one of {listed(KINDS)}, or check PART", remedy=remedy)
    kinds = KINDS.values() if kind is None else [KINDS[kind]]
    tell("\n\n".join(_described(each, commands) for each in kinds))
    return DONE


def _described(kind: Kind, commands: Mapping[str, str]) -> str:
    """Write a kind and its parts, a line each: name, where it comes from, what it does, what it lacks."""
    chosen = f"{kind.setting}=NAME" if kind.setting else "all that are installed are used"
    rows = [(part.name, part.origin, _remarked(part, commands)) for part in parts(kind)]
    rows += [(part.name, part.origin, "never used: tacevo has a part of this name") for part in shadowed(kind)]
    rows += [(part.name, part.origin, "not used: several packages have this name") for part in ambiguous(kind)]
    widths = [max(len(row[column]) for row in rows) for column in range(2)]
    lines = [f"  {name.ljust(widths[0])}  {origin.ljust(widths[1])}  {says}".rstrip() for name, origin, says in rows]
    return "\n".join([f"{kind.name} ({chosen}): {kind.does}", *lines])


def _remarked(part: Part, commands: Mapping[str, str]) -> str:
    missing = lacking(part)
    return f"needs {listed(missing)}, not installed here" if missing else _says(part, commands)


def _says(part: Part, commands: Mapping[str, str]) -> str:
    """Return in a line what a part does: a command of ours by its help, all others by their docstrings."""
    if part.kind is KINDS["commands"] and part.is_ours:
        return commands[part.name]
    return first_line_of(part)


def _check(named: str, overrides: Sequence[str]) -> int:
    """Check the parts that a word names, each made with the settings that a search of these overrides would have."""
    status = DONE
    for kind, name in _meant(named):
        tell(f"{kind.name}: {name}", flush=True)
        for promise, fault in _tested(kind, name, overrides):
            tell(f"  BROKEN  {promise}: {fault}" if fault else f"  kept    {promise}", flush=True)
            status = DIFFERENT if fault else status
    return status


def _meant(named: str) -> list[tuple[Kind, str]]:
    """Return the kinds and names of the parts that a word stands for.

    Raises:
        ConfigError: there is none, or several kinds have one of this name.
    """
    if match := _CHOSEN.fullmatch(named):
        kinds = [kind for kind in KINDS.values() if kind.setting == match["setting"]]
        if not kinds:
            expected = f"one of {listed(kind.setting for kind in KINDS.values() if kind.setting)}"
            raise ConfigError(match["setting"], place=named, expected=expected)
        find(kinds[0], match["name"])
        return [(kinds[0], match["name"])]
    if match := _FILE.fullmatch(named):
        return _in_file(Path(match["file"]), match["name"])
    found = [(kind, named) for kind in KINDS.values() if named in names(kind)]
    if not found:
        known = sorted({name for kind in KINDS.values() for name in names(kind)})
        remedy = nearest(named, known, "`tacevo parts` lists all")
        raise ConfigError(named, place="tacevo parts check", expected="the name of a part, or FILE.py", remedy=remedy)
    if len(found) > 1:
        expected = f"one of {listed(f'{kind.setting or kind.name}={named}' for kind, _ in found)}"
        raise ConfigError(f"{named}, a name of several parts", place="tacevo parts check", expected=expected)
    return found


def _in_file(file: Path, name: str | None) -> list[tuple[Kind, str]]:
    """Return the parts in a file, or that of a name; the file is imported."""
    if not file.is_file():
        raise ConfigError(str(file), place="tacevo parts check", expected="a file that is there")
    if name is not None:
        any_kind = Part(
            kind=KINDS["commands"], name=name, module=file.stem, attribute=name, origin=str(file), file=file
        )
        try:
            kind = kind_of(any_kind.load())
        except ConfigError as error:
            error.place = f"{file}:{name}"
            raise
        if kind is None:
            raise ConfigError(name, place=str(file), expected="a class of one of the kinds of parts")
        return [(kind, f"{file}:{name}")]
    module = import_file(file)
    found = [
        (kind, f"{file}:{made.__name__}")
        for made in vars(module).values()
        if inspect.isclass(made) and made.__module__ == module.__name__ and (kind := kind_of(made)) is not None
    ]
    if not found:
        raise ConfigError(str(file), place="tacevo parts check", expected="a file with a class of one of the kinds")
    return found


def _tested(kind: Kind, name: str, overrides: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the promises of a part, and what breaks each; the first is that a search can have it."""
    promise = "can be chosen, and made with its settings"
    try:
        part = _made(kind, name, overrides)
    except (ConfigError, PartError) as error:
        if not _is_of_part(error, kind):
            raise
        yield promise, str(error)
        return
    tell(f"  made with {listed(_shown(part), 'no settings')}", flush=True)
    yield promise, ""
    for contract in contracts(part, run=_run_of(kind, overrides)):
        yield str(contract), contract.fault()


def _run_of(kind: Kind, overrides: Sequence[str]) -> str | None:
    """Return the run or the sweep that an output is tried with, as in `run=runs/NAME`.

    Raises:
        ConfigError: another setting is given, and it has none.
    """
    if kind is not OUTPUTS:
        return None
    for override in overrides:
        if not override.startswith("run="):
            raise ConfigError(override, place="tacevo parts check", expected="run=RUN, which an output is tried with")
    return overrides[-1].removeprefix("run=") if overrides else None


def _shown(part: Any) -> list[str]:
    """Write the settings that a part was made with."""
    known = fields(part) if is_dataclass(part) else ()
    values = [(each.name, getattr(part, each.name)) for each in known if each.init and each.repr]
    return assignments([(name, value) for name, value in values if isinstance(value, int | float | str | Path | None)])


def _is_of_part(error: TacevoError, kind: Kind) -> bool:
    """Answer whether it is the part that a search cannot have, and not another setting that is wrong."""
    return error.place.startswith(("parts.", kind.setting or kind.name))


def _made(kind: Kind, name: str, overrides: Sequence[str]) -> Any:
    """Import a part and make it as a search would, in this process."""
    found = find(kind, name)
    if not kind.setting:
        loaded = found.load()
        if isinstance(loaded, Command):
            return loaded.describe
        return loaded() if inspect.isclass(loaded) else loaded
    value = f"[{_quoted(name)}]" if kind.name == "descriptors" else _quoted(name)
    config = compose(["experiment=demo", f"{kind.setting}={value}", *overrides])
    if not kind.decides:
        return part_of(config, kind)
    loaded = found.load()
    return loaded(**_settings(config, kind, found, loaded))


def _settings(config: RunConfig, kind: Kind, part: Part, loaded: Any) -> dict[str, Any]:
    """Return the settings of a part that decides: its own; of ours those of its group."""
    if not part.is_ours:
        return dict(config.parts.get(part.name, {}))
    group = getattr(config, kind.key[0])
    return {name: getattr(group, name) for name in inspect.signature(loaded).parameters}


def _quoted(name: str) -> str:
    """Write a name as Hydra reads it, where it is that of a file."""
    return f"'{name}'" if ":" in name else name
