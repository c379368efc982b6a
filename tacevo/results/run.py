"""A finished run as it was recorded, read and checked once."""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from tacevo.choices import DataSource, ExecutorKind
from tacevo.config.plain import from_plain
from tacevo.config.schema import LLMConfig, RunConfig, StoreConfig
from tacevo.config.tasks import contract_of
from tacevo.environment import usable_cores
from tacevo.errors import ConfigError, RunError, TacevoError
from tacevo.evolution.files import (
    Line,
    NetworkArchiveFile,
    PromptFile,
    read_archives,
    read_finished,
    rules_of,
)
from tacevo.evolution.lines import CandidateLine, GenerationLine, trained_networks, training_flops
from tacevo.records import DataFacts, Task, to_json
from tacevo.rules import Rules
from tacevo.storage.canonical import differences, shown
from tacevo.storage.ledger import Sealed
from tacevo.storage.run_directory import RunDirectory, RunRecord


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedRun:
    """A finished run, whose ledger's chain was checked."""

    directory: RunDirectory
    #: What run.json holds.
    record: RunRecord
    #: As this machine may use it, see `read_settings`.
    config: RunConfig
    ledger: Sealed[Line]
    #: What it was made under.
    rules: Rules
    #: Whether its stores keep the test predictions of its studies; those of a published sweep do not.
    has_predictions: bool = True
    #: The entries of its bundle; None where its stores are the directory that the configuration names.
    packed: Path | None = None

    @property
    def stores(self) -> Path:
        """Where its recorded answers are."""
        return self.packed or Path(self.config.store.root)

    @property
    def candidates(self) -> tuple[CandidateLine, ...]:
        """The candidates' lines."""
        return tuple(line for line in self.ledger.lines if isinstance(line, CandidateLine))

    @property
    def generations(self) -> tuple[GenerationLine, ...]:
        """The generations' lines, one at least."""
        return tuple(line for line in self.ledger.lines if isinstance(line, GenerationLine))

    @property
    def searched(self) -> bool:
        """Whether it asked for a network; the networks of other runs were given."""
        return any(line.request is not None for line in self.candidates)

    @property
    def spent(self) -> int:
        """What its trainings took in FLOPs, as its budget counts them (`tacevo.evolution.lines.training_flops`)."""
        images, training = self.record.data.counts[0], self.config.training
        trained = trained_networks(self.candidates)
        return training_flops(trained, images=images, epochs=training.epochs, seeds=training.seeds)

    def with_store(self, store: str) -> Self:
        """Return the run with its stores elsewhere; of a bundle's, only where images are made and kept."""
        return replace(self, config=replace(self.config, store=StoreConfig(root=store)))

    def read_archives(self) -> tuple[NetworkArchiveFile, PromptFile]:
        """Read both archives, and compare them with the ledger."""
        return read_archives(self.directory, self.generations[-1])


def read_recorded(path: Path, store: str | None = None) -> RecordedRun:
    """Read a finished run; `store` is where its stores lie, if not where the run had them.

    Raises:
        RunError: it is not finished, or something of it was damaged or edited.
        ConfigError: as `read_settings`.
    """
    directory = RunDirectory(path)
    record, ledger = read_finished(directory)
    config = read_settings(directory, record, store)
    return RecordedRun(directory=directory, record=record, config=config, ledger=ledger, rules=rules_of(ledger.lines))


def answered_by(record: RunRecord, llm: LLMConfig) -> str:
    """Name the model of a run, and say whose word that name is where another server than the provider's answered."""
    if not record.elsewhere:
        return llm.name
    whose = "the name is a label" if llm.label else "under this name"
    return f"{llm.name}, asked through another server, {whose}"


def read_config(path: Path, record: RunRecord) -> RunConfig:
    """Return the configuration of a run as it was recorded; `path` is its directory.

    Raises:
        RunError: it is not one of this version.
    """
    try:
        return from_plain(record.config)
    except ConfigError as error:
        expected = "a configuration of this version"
        raise RunError(str(error), place=f"{path}/run.json", expected=expected, remedy="restore it") from error


def read_settings(directory: RunDirectory, record: RunRecord, store: str | None = None) -> RunConfig:
    """Return the configuration of a run for this machine alone, with no more workers than cores.

    `store` is where its stores lie, if not where the run had them.

    Raises:
        RunError: run.json has another number of simulated images than the run had, another contract than its settings
            and its data give, or a configuration that this version does not know.
        ConfigError: its prompt pool is larger than its library.
    """
    config = read_config(directory.path, record)
    config.prompts.check_library(len(record.task.instructions))
    images = sum(record.data.counts)
    if config.data.source is DataSource.simulated and config.data.images != images:
        raise RunError(
            str(config.data.images),
            place=f"{directory.path}/run.json, data.images",
            expected=f"the {images} images of the run's data set",
            remedy="restore it",
        )
    _check_task(config, record, f"{directory.path}/run.json")
    root = config.store.root if store is None else store
    workers = min(config.executor.workers, usable_cores())
    here = replace(config.executor, kind=ExecutorKind.local, workers=workers)
    return replace(config, store=StoreConfig(root=root), executor=here)


def _check_task(config: RunConfig, record: RunRecord, place: str) -> None:
    """Check that the contract of a run's task is the one that its settings and its data give."""
    try:
        contract = contract_of(config.task, record.data)
    except ConfigError as error:
        place = f"{place}, {error.place}"
        raise RunError(error.got, place=place, expected=error.expected, remedy="restore it") from error
    if found := differences(to_json(record.task.contract), to_json(contract)):
        name = shown(found[0])
        place, expected = f"{place}, task.contract.{name}", f"{getattr(contract, name)}, as its settings and data say"
        raise RunError(str(getattr(record.task.contract, name)), place=place, expected=expected, remedy="restore it")


def read_run(directory: RunDirectory, store: str | None = None) -> tuple[RunConfig, Task, DataFacts]:
    """Read a run's configuration, task and data facts, finished or not; arguments and errors of `read_settings`."""
    record = directory.read_run()
    return read_settings(directory, record, store), record.task, record.data


@contextlib.contextmanager
def doubting(others: Sequence[str]) -> Iterator[None]:
    """Name the versions that are others here beside a failure of a replay."""
    try:
        yield
    except TacevoError as error:
        if others:
            doubt = f"another version may be the reason: {', '.join(others)}"
            error.remedy = f"{error.remedy}; {doubt}" if error.remedy else doubt
        raise
