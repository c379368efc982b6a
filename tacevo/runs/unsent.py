"""Searches whose temperatures reach no model: none is begun so, and what was begun so goes on, with a warning.

Models that refuse temperatures came after the first runs. Those went on without, as their ledgers say; a search that
begins today is told instead what else can carry its temperature (docs/llm.md).
"""

from collections.abc import Iterable
from pathlib import Path

from tacevo.config.plain import from_plain
from tacevo.config.schema import RunConfig
from tacevo.errors import ConfigError
from tacevo.evolution.lines import TEMPERATURE, CandidateLine
from tacevo.evolution.run_files import read_begun, read_ledger
from tacevo.records import Mode
from tacevo.runs.providers import answered_without, check_carrier
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.sweep_directory import SweepDirectory


def begun_without(config: RunConfig, runs: Iterable[RunDirectory]) -> str:
    """Check that a search which is about to begin has a temperature that can act, as far as the stores say.

    Args:
        config: of the search.
        runs: those that it is a part of, as a job is of its sweep; begun or not.

    Returns:
        A warning where it goes without its temperature all the same: the others asked the same model, and were begun
        so; or its answers are read from the store alone, where they lie as they came. Else empty.

    Raises:
        ConfigError: the temperature cannot act, as `check_carrier`.
    """
    try:
        check_carrier(config)
    except ConfigError as error:
        if config.llm.mode is Mode.replay:
            why = "recorded answers are read as they came"
        elif any(_went_without(run, config) for run in runs):
            why = "the other jobs of this sweep were begun so"
        else:
            raise
        return f"warning: no temperature is sent ({error.got}), since {why}; T is nominal"
    return ""


def recalled_without(config: RunConfig, path: Path) -> str:
    """Check a search that is about to begin in a directory, and may have all of its answers in the store.

    What a server tells is compared when it is first asked; of recorded answers, none may be asked at all.

    Returns:
        As `begun_without`.

    Raises:
        ConfigError: as `begun_without`.
    """
    others = _jobs_beside(path)
    return begun_without(config, others) if others or answered_without(config) else ""


def _jobs_beside(path: Path) -> list[RunDirectory]:
    """List the runs of the sweep that a run directory is a job of; none where it is no job."""
    sweep = SweepDirectory(path.parent)
    jobs = sweep.read().jobs if sweep.is_one else ()
    return [sweep.run(job) for job in jobs] if path.name in {job.name for job in jobs} else []


def _went_without(run: RunDirectory, config: RunConfig) -> bool:
    """Answer whether a run asked the same models, and its ledger says that a temperature was not sent."""
    record = read_begun(run)
    if record is None or from_plain(record.config).llm.names != config.llm.names:
        return False
    lines = (line for line in read_ledger(run).lines if isinstance(line, CandidateLine))
    return any(TEMPERATURE in line.dropped for line in lines)
