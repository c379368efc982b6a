"""What decides the results of a run, and its hash."""

from tacevo.choices import OPTIONAL_SAMPLING, ArchiveKind
from tacevo.config.schema import LLMConfig, RunConfig
from tacevo.records import Json, to_json, written
from tacevo.storage.canonical import content_hash

#: Settings of the archive that decide nothing with a kind of it; that it is `cvt` was no setting at first.
_NO_EFFECT = {
    ArchiveKind.cvt: ("kind", "kept", "reevaluated"),
    ArchiveKind.best: ("reevaluated",),
    ArchiveKind.extract: ("kept",),
}


def identity(config: RunConfig) -> dict[str, Json]:
    """Return the part of a configuration that decides a run's results, for its ledger.

    The number of generations is left out, so that a longer run begins with the very lines of a shorter one;
    data enter by their fingerprint, task files by their text; where a run is computed and written, and how it
    is watched, does not enter. Settings that came later enter only where they are set, so that a run without them
    stays the run it was.
    """
    settings = config.archive
    archive = {**written(settings), "kept": settings.kept, "reevaluated": settings.reevaluated}
    for name in _NO_EFFECT[settings.kind]:
        archive.pop(name, None)
    return {
        "seed": config.seed,
        "search": {"candidates": config.search.candidates, "initial": config.search.initial},
        "llm": llm_identity(config.llm),
        "archive": archive,
        "temperature": written(config.temperature),
        "prompts": written(config.prompts),
        "proposals": written(config.proposals),
        "training": written(config.training),
        "gate": written(config.gate),
        "numerics": config.numerics.kind.value,
    }


def llm_identity(llm: LLMConfig) -> dict[str, Json]:
    """Return the settings of a model that decide its answers; sampling settings only where they are set."""
    named = ("provider", "model", "max_tokens", "slip_rate")
    return {name: value for name, value in written(llm).items() if name in named or name in OPTIONAL_SAMPLING}


def config_hash(config: RunConfig) -> str:
    """Hash what decides the results of a job: 64 hex digits.

    Unlike a ledger's header it is known without the data, and holds the number of generations.
    """
    decisive: dict[str, Json] = {"config": identity(config), "generations": config.search.generations}
    return content_hash({**decisive, "data": to_json(config.data), "task": to_json(config.task)})
