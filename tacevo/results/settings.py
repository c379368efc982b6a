"""The settings of a run as they were recorded, finished or not."""

from dataclasses import replace
from pathlib import Path

from tacevo.config.plain import from_plain
from tacevo.config.schema import RunConfig, StoreConfig
from tacevo.config.task_texts import contract_of
from tacevo.environment import usable_cores
from tacevo.errors import ConfigError, RunError
from tacevo.parts.facts import HERE
from tacevo.records import to_json
from tacevo.results.publishable import last_part
from tacevo.results.whereabouts import found_store
from tacevo.storage.canonical import differences, shown
from tacevo.storage.members import Member
from tacevo.storage.run_directory import RunDirectory, RunRecord


def read_config(path: Path, record: RunRecord) -> RunConfig:
    """Return the configuration of a run as it was recorded; `path` is its directory.

    Raises:
        RunError: it is not one of this version.
    """
    try:
        return from_plain(record.config)
    except ConfigError as error:
        expected, remedy = "a configuration of this version", "" if error.remedy else "restore it"
        raise RunError(str(error), place=f"{path}/run.json", expected=expected, remedy=remedy) from error


def read_settings(directory: RunDirectory, record: RunRecord, store: str | None = None) -> RunConfig:
    """Return the configuration of a run for this machine alone, with no more workers than cores.

    `store` is where its stores lie, if not where the run had them (`tacevo.results.whereabouts`). Of the place that a
    bundle names for its data the last part is taken: `tacevo publish` writes no more.

    Raises:
        RunError: run.json has another number of simulated images than the run had, another contract than its settings
            and its data give, or a configuration that this version does not know.
        ConfigError: its prompt pool is larger than its library.
    """
    config = read_config(directory.path, record)
    config.prompts.check_library(len(record.task.instructions))
    images = sum(record.data.counts)
    if config.data.facts.is_made and config.data.images != images:
        raise RunError(
            str(config.data.images),
            place=f"{directory.path}/run.json, data.images",
            expected=f"the {images} images of the run's data set",
            remedy="restore it",
        )
    _check_task(config, record, f"{directory.path}/run.json")
    root = found_store(directory, config) if store is None else store
    workers = min(config.executor.workers, usable_cores())
    here = replace(config.executor, kind=HERE, workers=workers)
    data = config.data
    if isinstance(directory.path, Member) and data.root is not None:
        data = replace(data, root=last_part(data.root))
    return replace(config, data=data, store=StoreConfig(root=root), executor=here)


def _check_task(config: RunConfig, record: RunRecord, place: str) -> None:
    """Check that the contract of a run's task is the one that its settings and its data give."""
    try:
        contract = contract_of(config.task, record.data)
    except ConfigError as error:
        place = f"{place}, {error.place}"
        raise RunError(error.got, place=place, expected=error.expected, remedy="restore it") from error
    if differing := differences(to_json(record.task.contract), to_json(contract)):
        name = shown(differing[0])
        place, expected = f"{place}, task.contract.{name}", f"{getattr(contract, name)}, as its settings and data say"
        raise RunError(str(getattr(record.task.contract, name)), place=place, expected=expected, remedy="restore it")


def settings_of(directory: RunDirectory) -> RunConfig:
    """Return the configuration of a run, finished or not, as `read_settings`."""
    return read_settings(directory, directory.read_run())
