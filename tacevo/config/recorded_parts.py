"""The parts that a configuration chooses, where they decide results: ours, and what is recorded of a user's."""

from collections.abc import Iterator, Mapping
from typing import Any

from tacevo.config.schema import RunConfig
from tacevo.errors import ConfigError
from tacevo.parts.kinds import ARCHIVES, DESCRIPTORS, KINDS, Kind
from tacevo.parts.registry import load
from tacevo.records import Json, written
from tacevo.storage.canonical import content_hash

#: The kinds whose parts decide.
DECIDING = tuple(kind for kind in KINDS.values() if kind.decides)


def chosen(config: RunConfig, kind: Kind) -> tuple[str, ...]:
    """Return the names of the parts of a kind that a configuration chooses: one, or of descriptors one an axis."""
    group, setting = kind.key
    value = getattr(getattr(config, group), setting)
    return tuple(value) if isinstance(value, tuple) else (str(value),)


def not_ours(plain: Mapping[str, Any], kind: Kind) -> list[str]:
    """Return the names at the setting of a kind that are not ours, of a composed configuration.

    What is no text is passed over: it is refused with all settings.
    """
    group, setting = kind.key
    value = plain[group][setting]
    names = value if isinstance(value, list) else [value]
    return [name for name in names if isinstance(name, str) and name not in kind.ours]


def brought(config: RunConfig) -> Iterator[tuple[Kind, str]]:
    """Yield the kinds and names of the parts that decide and are not ours."""
    for kind in DECIDING:
        yield from ((kind, name) for name in chosen(config, kind) if name not in kind.ours)


def own_axes(config: RunConfig) -> tuple[str, ...]:
    """Return the axes of the network archive that descriptors of a user's measure, in their order."""
    return tuple(name for name in chosen(config, DESCRIPTORS) if name not in DESCRIPTORS.ours)


def constant(config: RunConfig, kind: Kind, name: str) -> bool:
    """Return a constant of the class of the part that a configuration chooses, e.g. `crosses` of `PARENTS`."""
    (part,) = chosen(config, kind)
    if part in config.code:
        return config.code[part].constants[name]
    value: bool = getattr(load(kind, part), name)
    return value


def check_code(config: RunConfig) -> None:
    """Compare the parts that a configuration chooses with what it records of their code.

    Raises:
        ConfigError: a name is neither one of ours nor one whose code is recorded; or code is recorded that nothing
            chooses, or of another kind, or without its constants.
    """
    known = {}
    for kind, name in brought(config):
        code = config.code.get(name)
        if code is None:
            expected = f"one of {', '.join(kind.ours)}, or a part whose code is recorded"
            raise ConfigError(name, place=kind.setting, expected=expected)
        if name in known or code.kind != kind.name or set(code.constants) != set(kind.constants):
            expected = f"one part of the kind {kind.name}, with {', '.join(kind.constants) or 'no constants'}"
            raise ConfigError(f"{code.kind}, {sorted(code.constants)}", place=f"code.{name}", expected=expected)
        known[name] = code
    for name in sorted(config.code.keys() - known.keys()):
        raise ConfigError(name, place="code", expected="code of parts that are chosen")


def parts_identity(config: RunConfig) -> dict[str, Json]:
    """Return what a run's results depend on of the parts that a user brought, by name; empty without any."""
    return {
        name: {**written(config.code[name]), "settings": dict(config.parts.get(name, {}))}
        for _, name in sorted(brought(config), key=lambda pair: pair[1])
    }


def decision(code: str, settings: Mapping[str, Json], method: str, given: Json) -> dict[str, Json]:
    """Return the question that a decision is stored under: of code by its hash, and of what is given by its."""
    return {"part": code, "settings": dict(settings), "method": method, "given": content_hash(given)}


def centroids_asked(config: RunConfig) -> tuple[str, Json]:
    """Return the method that says where the niches of a user's archive are, and what it is given."""
    archive = config.archive
    return f"{ARCHIVES.name}.centroids", {"niches": archive.niches, "axes": len(archive.axes)}


def code_hash(module: str, attribute: str, sources: Mapping[str, str]) -> str:
    """Return what names the code of a part: the hash of its sources, with the name of its class; 64 hex digits."""
    return content_hash({"module": module, "attribute": attribute, "sources": dict(sources)})
