"""The settings that decide the results of a run, and their hash."""

from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations

from tacevo.choices import OPTIONAL_SAMPLING
from tacevo.config.recorded_parts import parts_identity
from tacevo.config.schema import LLMConfig, RunConfig
from tacevo.records import Json, Task, to_json, written
from tacevo.storage.canonical import content_hash


def identity(config: RunConfig) -> dict[str, Json]:
    """Return the part of a configuration that decides a run's results, for its ledger.

    What ends a run is left out (`length`), so that a longer run begins with the very lines of a shorter one;
    data enter by their fingerprint, task files by their text; where a run is computed and written, and how it
    is watched, does not enter. Settings that came later enter only where they are set, so that a run without them
    stays the run it was.
    """
    archive = {**written(config.archive), "kept": config.archive.kept}
    if config.archive.kind == "cvt":  # the only one of early releases, which had neither setting
        del archive["kind"], archive["kept"]
    return {
        "seed": config.seed,
        "search": {"candidates": config.search.candidates, "initial": config.search.initial},
        "llm": {
            **llm_identity(config.llm),
            **({"own": dict(own)} if (own := config.own_settings(config.llm.provider)) else {}),
        },
        "archive": archive,
        "temperature": written(config.temperature),
        "prompts": written(config.prompts),
        "proposals": written(config.proposals),
        "training": written(config.training),
        "gate": written(config.gate),
        "numerics": config.numerics.kind.value,
        **({"parts": parts} if (parts := parts_identity(config)) else {}),
    }


def task_hash(task: Task) -> str:
    """Hash a task's texts, for a ledger: 64 hex digits; given networks enter only where there are any."""
    return content_hash(written(task))


def llm_identity(llm: LLMConfig) -> dict[str, Json]:
    """Return the settings of a model that decide its answers; those that came later only where they are set."""
    named = ("provider", "model", "max_tokens", "slip_rate", "system", "space", "models", "choice", *OPTIONAL_SAMPLING)
    provider = llm.provider.rpartition("/")[2]  # of one in a file, no path is recorded
    asked = written(replace(llm, model=llm.name, provider=provider))
    return {name: value for name, value in asked.items() if name in named}


def config_hash(config: RunConfig) -> str:
    """Hash what decides the results of a job: 64 hex digits.

    Unlike a ledger's header it is known without the data, and holds what ends the run.
    """
    return content_hash(decisive(config))


def decisive(config: RunConfig) -> dict[str, Json]:
    """Return what `config_hash` hashes."""
    settings: dict[str, Json] = {"config": identity(config), **length(config)}
    if config.search.networks:  # by name; a ledger has their texts
        settings["networks"] = list(config.search.networks)
    return {**settings, "data": written(config.data), "task": to_json(config.task)}


def twins(jobs: Iterable[tuple[str, int, RunConfig]]) -> list[tuple[str, str]]:
    """Return the pairs of arms whose searches must find the same networks, of jobs with their arms and seeds.

    So it is where those of every shared seed, at least one, differ only in whether uniformly drawn prompts are
    recorded: nothing is then drawn by that record.
    """
    hashes: dict[str, dict[int, str]] = {}
    for arm, seed, config in jobs:
        hashes.setdefault(arm, {})[seed] = _recording(config)
    return [
        (one, other)
        for one, other in combinations(hashes, 2)
        if (shared := hashes[one].keys() & hashes[other].keys())
        and all(hashes[one][seed] == hashes[other][seed] for seed in shared)
    ]


def twins_of(arm: str | None, pairs: Iterable[tuple[str, str]]) -> list[str]:
    """Return the arms that stand in a pair with this one."""
    return [other for pair in pairs if arm in pair for other in pair if other != arm]


def _recording(config: RunConfig) -> str:
    """Hash a configuration, as if it recorded prompts where it does not."""
    if config.prompts.policy == "none":
        config = replace(config, prompts=replace(config.prompts, policy="uniform"))
    return config_hash(config)


def length(config: RunConfig) -> dict[str, Json]:
    """Return what decides where a run ends, and nothing before it; the FLOPs only where they are bounded."""
    flops = config.search.training_flops
    bound: dict[str, Json] = {} if flops is None else {"training_flops": flops}
    return {"generations": config.search.generations, **bound}
