"""Run directories into MLflow: one, those of a sweep, or all below a directory.

What it promises: nothing is written into a run directory; what stands in MLflow already is not written again; a run
that is damaged is reported, and the others are written.
"""

import logging
import os
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

from tacevo.errors import RunError, TacevoError
from tacevo.evolution.run_files import read_ledger
from tacevo.redaction import check_address
from tacevo.storage.places import meant
from tacevo.storage.run_directory import RunDirectory
from tacevo.tracking.address import MlflowError, prepare, store_address, told
from tacevo.tracking.shown import read_settings

#: A directory with one of these is that of a run, perhaps a damaged one.
_MARKS = frozenset({"run.json", "ledger.jsonl"})


def track(path: Path, uri: str, show: Callable[[int, int], None]) -> tuple[Mapping[str, int], tuple[str, ...]]:
    """Mirror run directories into MLflow.

    Args:
        path: a run directory, the directory of a sweep, or one that contains either.
        uri: the tracking URI; empty for the one in each run's configuration or else in MLFLOW_TRACKING_URI.
        show: receives the number of runs that are done, and of all.

    Returns:
        How many runs are in each store, by its tracking URI (an empty one is that of MLFLOW_TRACKING_URI), and why the
        others are not, one line each.

    Raises:
        RunError: `path` holds no run; MLflow fails; or `path` is a run directory, and it is damaged.
        ConfigError: the URI holds a password; or `path` is a run directory, and no URI is known.
        OSError: a directory cannot be read.
    """
    check_address(uri, "--uri")
    prepare()
    done: Counter[str] = Counter()
    failed: list[str] = []
    runs = find_runs(path)
    for number, run in enumerate(runs):
        show(number, len(runs))
        try:
            done[_mirror(run, uri)] += 1
        except TacevoError as error:
            if run == path or isinstance(error, MlflowError):
                raise
            failed.append(str(error))
    show(len(runs), len(runs))
    return done, tuple(dict.fromkeys(failed))  # a deleted experiment is the same of all


def find_runs(path: Path) -> tuple[Path, ...]:
    """Find the run directories in a directory, by name; hidden directories are left out, and links not followed.

    Raises:
        RunError: the directory holds none.
        OSError: a directory cannot be read.
    """

    def fail(error: OSError) -> None:
        raise error

    runs: list[Path] = []
    for directory, below, files in os.walk(path, onerror=fail) if path.exists() else ():
        below[:] = sorted(name for name in below if not name.startswith(".")) if _MARKS.isdisjoint(files) else ()
        if not _MARKS.isdisjoint(files):
            runs.append(Path(directory))
    if not runs:
        raise RunError(
            "a directory without run.json, here and below" if path.exists() else "a path that does not exist",
            place=str(path),
            expected="a run directory, or one that contains some",
            remedy="" if path.exists() else meant(path),
        )
    return tuple(runs)


def _mirror(path: Path, given: str) -> str:
    """Mirror one run; return the URI of its store, empty for that of MLFLOW_TRACKING_URI."""
    directory = RunDirectory(path)
    settings = read_settings(directory.read_run(), f"{path}/run.json")
    read_ledger(directory)  # checks the chain
    uri = given or ("" if "***" in settings.uri else settings.uri)  # earlier versions hid passwords so
    address = store_address(uri)
    with told(str(path), uri, "run the same command again when the store can be used: it writes what is missing"):
        from tacevo.tracking.mirror import mirror

        logging.getLogger("mlflow").setLevel(logging.CRITICAL)  # its errors are reported in one line
        try:
            mirror(path, uri=address, experiment=settings.experiment, finished=None)
        except LookupError as error:  # a line names a record that is missing
            got, expected = f"{type(error).__name__}: {error}", "the records of a run"
            raise RunError(got, place=str(path), expected=expected, remedy="restore them") from error
    return uri
