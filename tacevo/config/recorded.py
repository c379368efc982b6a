"""The configuration, task and data facts that a run recorded."""

import contextlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace

from tacevo.choices import DataSource
from tacevo.config.compose import from_plain
from tacevo.config.schema import RunConfig, StoreConfig
from tacevo.errors import CacheMissError, ConfigError, DivergenceError, RunError
from tacevo.records import Contract, DataFacts
from tacevo.search.proposals import Instruction, Task
from tacevo.storage.run_directory import RunDirectory


@contextlib.contextmanager
def doubting(others: Sequence[str]) -> Iterator[None]:
    """Say beside a failure of a replay which versions are others; where none is, it stays as it is."""
    try:
        yield
    except (CacheMissError, ConfigError, DivergenceError) as error:
        doubt = f"this may come of another version: {', '.join(others)}" if others else ""
        error.remedy = "; ".join(part for part in (error.remedy, doubt) if part)
        raise


def read_run(directory: RunDirectory, store: str | None = None) -> tuple[RunConfig, Task, DataFacts]:
    """Read a run's configuration, task and data facts.

    Args:
        directory: the run's.
        store: where its stores lie, if not where the run had them.

    Returns:
        The configuration, with no more workers than this machine has cores; the task; the facts.

    Raises:
        RunError: run.json is missing or damaged, or speaks of more or fewer simulated images than the run had.
        ConfigError: its configuration is none of this version.
    """
    run = directory.read_run()
    try:
        task = run["task"]
        rebuilt = Task(
            name=task["name"],
            contract=Contract.from_json(task["contract"]),
            baseline=task["baseline"],
            system=task["system"],
            instructions=tuple(Instruction(**entry) for entry in task["instructions"]),
            crossover=task["crossover"],
        )
        config, facts = from_plain(run["config"]), DataFacts.from_json(run["data"])
    except (KeyError, TypeError, ValueError) as error:
        raise RunError(f"{directory.path}/run.json is damaged: {type(error).__name__}: {error}") from error
    config.prompts.check_library(len(rebuilt.instructions))
    images = sum(facts.counts)
    if config.data.source is DataSource.simulated and config.data.images != images:
        raise RunError(
            f"{directory.path}/run.json has data.images={config.data.images}, and a data set of {images}; restore it"
        )
    root = config.store.root if store is None else store
    workers = min(config.executor.workers, os.cpu_count() or 1)
    here = replace(config.executor, workers=workers)
    return replace(config, store=StoreConfig(root=root), executor=here), rebuilt, facts
