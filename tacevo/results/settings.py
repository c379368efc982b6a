"""The settings of a run as they were recorded, finished or not, and where its stores and its data lie on this machine.

A command may be given in another directory than the run was made in. A relative `store.root` or `data.root` is looked
up in the directory that the run was made in, as far as its `run.dir` tells, then in the working directory, then in the
directories above the run, the nearest first. The directories above end at one that another user owns or that everyone
may write to: whoever lays a store there would decide what is read. A name with `..` is
looked up in the first two alone.

A store is the run's only where it holds a training of the run: another one of that name is never read in its place.
Where none is found, the recorded name stays, and what would write there asks `RecordedRun.check_stores` first.

Nothing is looked up by what a bundle says of its author's stores; of its data set, only by the last part of the name.
"""

import itertools
import os
import re
import stat
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path, PurePath

from tacevo.config.plain import from_plain
from tacevo.config.schema import RunConfig, StoreConfig
from tacevo.config.task_texts import contract_of
from tacevo.environment import usable_cores
from tacevo.errors import ConfigError, RunError
from tacevo.parts.facts import HERE
from tacevo.records import to_json
from tacevo.results.publishable import last_part
from tacevo.storage.canonical import differences, shown
from tacevo.storage.members import Member
from tacevo.storage.run_directory import RunDirectory, RunRecord
from tacevo.storage.store import place_of


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

    `store` is where its stores lie, if not where the run had them (`found_store`). Of the place that a bundle
    names for its data the last part is taken: `tacevo publish` writes no more.

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


#: The key of a training in a line of a ledger; the store has the training under this name.
_EVALUATION = re.compile(rb'"evaluation":"([0-9a-f]{64})"')


def found_store(directory: RunDirectory, config: RunConfig) -> str:
    """Return where the stores of a run in a directory lie; where they are not found, what the run recorded."""
    name = config.store.root
    if PurePath(name).is_absolute() or isinstance(directory.path, Member):
        return name
    paths = [path for path in _paths(name, directory.path, config.run.dir) if path.is_dir()]
    if key := _first_training(directory):
        paths = [path for path in paths if (path / place_of("evaluations", key)).exists()]
    return _as_written(name, paths)


def _first_training(directory: RunDirectory) -> str | None:
    """Return the key of the first training in the ledger of a run; None without one."""
    if not directory.ledger.exists():
        return None
    with directory.ledger.open("rb") as lines:
        return next((found[1].decode() for line in lines if (found := _EVALUATION.search(line))), None)


def found_data(directory: RunDirectory, config: RunConfig) -> str | None:
    """Return where the data set of a run lies; where nothing is found, what the run recorded."""
    name = config.data.root
    if name is None or config.data.facts.is_made:  # which is made, and lies nowhere
        return name
    return _as_written(name, [path for path in _paths(name, directory.path, config.run.dir) if path.exists()])


def _paths(name: str, run: Path, made_as: str | None) -> Iterator[Path]:
    """List the paths that a name in the settings of a run may mean, each once."""
    known: set[Path] = set()
    for folder in (Path(),) if PurePath(name).is_absolute() else _folders(name, run, made_as):
        path = folder / name
        if (real := path.resolve()) not in known:
            known.add(real)
            yield path


def _folders(name: str, run: Path, made_as: str | None) -> Iterator[Path]:
    """List the directories in which a relative name of a run is looked up; a bundle lies where its file does."""
    path = run.file.resolve() if isinstance(run, Member) else run.resolve()
    own = PurePath("runs", path.name) if made_as is None else PurePath(made_as)
    is_there = not own.is_absolute() and path.parts[-len(own.parts) :] == own.parts
    if is_there and not isinstance(run, Member):
        yield Path(*path.parts[: -len(own.parts)])
    yield Path()
    if ".." not in PurePath(name).parts:
        yield from itertools.takewhile(_is_own, path.parents)


def _is_own(folder: Path) -> bool:
    """Return whether a directory is this user's, and not everyone may lay something into it."""
    try:
        found = folder.stat()
    except OSError:
        return False
    return found.st_uid == os.geteuid() and not found.st_mode & stat.S_IWOTH


def _as_written(name: str, paths: list[Path]) -> str:
    """Return the first path, by the name itself where that leads there from the working directory."""
    if not paths or (os.path.exists(name) and os.path.samefile(name, paths[0])):
        return name
    return str(paths[0])
