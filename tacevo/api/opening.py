"""Runs and sweeps, opened by their path."""

from __future__ import annotations

import contextlib
import os
import weakref
from pathlib import Path

from tacevo.api.runs import Run
from tacevo.api.sweeps import Sweep
from tacevo.bundles.open import Opened, opened
from tacevo.storage.sweep_directory import SweepDirectory

#: The remedy where one run is needed and a sweep was named.
ONE_RUN = "compare its arms by `tacevo ablations`, or name one of its jobs, SWEEP/JOB"


def open(path: str | os.PathLike[str], *, store: str | os.PathLike[str] | None = None) -> Run | Sweep:
    """Open a finished run or a sweep, and compare its records with each other; nothing is trained or asked.

    Args:
        path: the directory of a run or of a sweep, a bundle, or one job of a sweep, `SWEEP/JOB` or `SWEEP.zip/JOB`.
        store: the directory of the stores, if it was moved.

    Raises:
        RunError: nothing of this kind lies there, or it is not finished, or something of it was damaged or edited.
        BundleError: the bundle is damaged, or holds what none should.
    """
    place, named = Path(path), None if store is None else str(store)
    if SweepDirectory(place).is_one:  # of a directory, what is finished is shown, and the rest is told
        return Sweep(place.resolve().name, Opened(folder=place, store=place, jobs=()), named, contextlib.ExitStack())
    release = contextlib.ExitStack()
    with contextlib.ExitStack() as entered:
        found = entered.enter_context(opened(place))
        release = entered.pop_all()
    try:
        made = (
            Sweep(place.stem, found, None, release)
            if found.jobs is not None
            else run_in(found, found.folder, named, release)
        )
    except BaseException:
        release.close()
        raise
    weakref.finalize(made, release.close)
    return made


def open_run(path: str | os.PathLike[str], *, store: str | os.PathLike[str] | None = None) -> Run:
    """Open one run, as `open`.

    Raises:
        RunError: it is a sweep; or as `open`.
    """
    made = open(path, store=store)
    if isinstance(made, Run):
        return made
    made.place.one_run(ONE_RUN)
    raise AssertionError("a sweep has no one run")


def run_in(place: Opened, folder: Path, store: str | None, release: contextlib.ExitStack | None = None) -> Run:
    """Return a run of a place that is open, by its directory, with the stores of a bundle or those that were named."""
    used = str(place.store) if place.digest is not None and store is None else store
    return Run(place, place.read(folder, used), used, release or contextlib.ExitStack())
