"""What decides the results of a run, and its hash."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from tacevo.choices import OPTIONAL_SAMPLING, ArchiveKind, Axis, Device, OperatorScope
from tacevo.config.compose import from_plain
from tacevo.config.schema import RunConfig
from tacevo.records import Json, to_json
from tacevo.storage.canonical import content_hash


def identity(config: RunConfig) -> dict[str, Json]:
    """Return the part of a configuration that decides a run's results, for its ledger.

    The number of generations is left out, so that a longer run begins with the very lines of a shorter one;
    data enter by their fingerprint, task files by their text; where a run is computed and written, and how it
    is watched, does not enter. Settings that came later enter only where they are set, so that a run without them
    stays the run it was.
    """
    whole: dict[str, Any] = asdict(config)
    chosen = {key: whole[key] for key in ("seed", "archive", "temperature", "prompts", "proposals", "training", "gate")}
    chosen["search"] = {key: whole["search"][key] for key in ("candidates", "initial")}
    chosen["llm"] = {key: whole["llm"][key] for key in ("provider", "model", "max_tokens", "slip_rate")}
    chosen["llm"] |= {key: whole["llm"][key] for key in OPTIONAL_SAMPLING if whole["llm"][key]}
    if config.training.device is Device.cpu:
        del chosen["training"]["device"]
    if not config.proposals.repair_attempts:
        del chosen["proposals"]["repair_attempts"]
    if config.prompts.pool is None:
        del chosen["prompts"]["pool"]
    if config.proposals.operator_for is OperatorScope.generation:
        del chosen["proposals"]["operator_for"]
    if config.archive.kind is ArchiveKind.cvt:
        del chosen["archive"]["kind"], chosen["archive"]["kept"]
    if config.archive.axes == list(Axis):
        del chosen["archive"]["axes"]
    chosen["numerics"] = whole["numerics"]["kind"]
    return chosen


def config_hash(config: RunConfig) -> str:
    """Hash what decides the results of a job: 64 hex digits."""
    return content_hash(decisive(config))


def recorded_hash(config: Mapping[str, Json]) -> str:
    """Hash what decides the results of a run, from the configuration in its run.json: 64 hex digits.

    Raises:
        ConfigError: it is no configuration of this version.
    """
    return config_hash(from_plain(config))


def decisive(config: RunConfig) -> Json:
    """Return what decides the results of a job.

    Unlike a ledger's header it is known without the data, and holds the number of generations.
    """
    part = {"config": identity(config), "generations": config.search.generations}
    return to_json({**part, "data": config.data, "task": config.task})
