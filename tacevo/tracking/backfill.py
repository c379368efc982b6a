"""Run directories into MLflow: one, those of a sweep, or all below a folder.

What it promises: nothing but its id is written into a run directory; what stands in MLflow already is not written
again; a run that is damaged, or that MLflow refuses, is told of, and the others are written.
"""

import contextlib
import logging
import os
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tacevo.errors import ConfigError, RunError, TacevoError
from tacevo.redaction import Veil, veiled, without_password
from tacevo.search.files import read_ledger
from tacevo.storage.run_directory import RunDirectory
from tacevo.tracking.entries import viewing
from tacevo.tracking.process import prepare

#: A folder with one of these is that of a run, perhaps a damaged one.
_MARKS = frozenset({"run.json", "ledger.jsonl"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Tracked:
    """What came of each run."""

    #: The folders whose runs are in MLflow now.
    done: tuple[Path, ...]
    #: Why the others are not, one line each.
    failed: tuple[str, ...]
    #: How to look at each store that was written, and how many of the runs are there.
    views: tuple[tuple[str, int], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Target:
    """A store, and the experiment in it."""

    uri: str
    experiment: str


class _StoreAbsentError(RunError):
    """The store cannot be reached, by this run or any other."""


def track(path: Path, uri: str | None, show: Callable[[int, int], None]) -> Tracked:
    """Mirror run directories into MLflow.

    Args:
        path: a run directory, the folder of a sweep, or a folder with either below it.
        uri: the tracking URI; None for the one in each run's configuration.
        show: is told how many runs are done, of how many.

    Raises:
        RunError: there is no run; or `path` is a single run, and it is damaged or could not be written.
        ConfigError: `path` is a single run, and neither it nor the caller names a URI.
    """
    prepare()
    done: list[Path] = []
    failed: list[str] = []
    views: Counter[str] = Counter()
    absent: set[str] = set()
    runs = find_runs(path, lambda error: failed.append(_unreadable(error)))
    show(0, len(runs))
    for number, run in enumerate(runs, 1):
        try:
            target = _target(run, uri)
            _mirror(run, target, absent)
        except TacevoError as error:
            if run == path:
                raise
            failed.append(str(error))
        else:
            done.append(run)
            views[viewing(target.uri)] += 1
        show(number, len(runs))
    return Tracked(done=tuple(done), failed=tuple(failed), views=tuple(views.items()))


def find_runs(path: Path, unreadable: Callable[[OSError], object]) -> tuple[Path, ...]:
    """Find the run directories in a folder, by name; hidden folders are left out, and links are not followed.

    Args:
        path: the folder.
        unreadable: is told of each folder that cannot be searched.

    Raises:
        RunError: there is none.
    """
    found: list[Path] = []
    for folder, below, files in os.walk(path, onerror=unreadable):
        if _MARKS.isdisjoint(files):
            below[:] = sorted(name for name in below if not name.startswith("."))
        else:
            below.clear()
            found.append(Path(folder))
    if not found:
        raise RunError(f"{path} is neither the folder of a run (it has no run.json) nor holds one; give what has runs")
    return tuple(found)


def _target(path: Path, uri: str | None) -> _Target:
    """Read where a run is to be written, and see that it is sound."""
    directory = RunDirectory(path)
    run = directory.read_run()
    try:
        read_ledger(directory)
    except OSError as error:
        raise RunError(_unreadable(error)) from error
    tracking = run.config.get("tracking", {})
    target = _Target(uri=uri or tracking.get("uri", ""), experiment=tracking.get("experiment", "tacevo"))
    if not target.uri:
        raise ConfigError(f"{path} was run with tracking=none; give --uri, e.g. --uri sqlite:///mlflow.db")
    if "***" in target.uri:
        raise ConfigError(f"{path} keeps no password of {target.uri}; give the whole address with --uri")
    return target


def _mirror(path: Path, target: _Target, absent: set[str]) -> None:
    """Mirror one run; a store that turns out to be absent is added to those that are not asked again."""
    if target.uri in absent:
        raise RunError(f"{path} was not tried, because the store could not be reached before")
    try:
        with (
            contextlib.redirect_stdout(Veil(sys.stdout, target.uri)),
            contextlib.redirect_stderr(Veil(sys.stderr, target.uri)),
        ):
            _ask(path, target)
            _write(path, target)
    except _StoreAbsentError:
        absent.add(target.uri)
        raise


def _ask(path: Path, target: _Target) -> None:
    """See that the store answers; whatever it fails with then, no other run will come into it either."""
    from tacevo.tracking.client import open_store

    logging.getLogger("mlflow").setLevel(logging.CRITICAL)  # its errors come here, and are told in one line
    try:
        open_store(target.uri).search_experiments(max_results=1)
    except Exception as error:  # a driver's own, for which there is no common class
        raise _StoreAbsentError(_refusal(path, target, error)) from error


def _write(path: Path, target: _Target) -> None:
    from tacevo.tracking.mirror import mirror

    try:
        mirror(path, uri=target.uri, experiment=target.experiment, finished=None)
    except TacevoError:
        raise
    except Exception as error:  # as in `_ask`
        raise RunError(_refusal(path, target, error)) from error


def _refusal(path: Path, target: _Target, error: Exception) -> str:
    """Say in one line why a run is not in a store, without the password of its address."""
    reason = veiled(str(error), target.uri).partition("\n")[0]
    hint = " (install the database driver that this address needs)" if isinstance(error, ImportError) else ""
    return (
        f"{path} could not be written to {without_password(target.uri)}: {type(error).__name__}: {reason}{hint}; when "
        "that is mended, the same command writes what is missing"
    )


def _unreadable(error: OSError) -> str:
    return f"{error.filename} cannot be read: {error.strerror}"
