"""Runs and sweeps, opened by their path."""

from __future__ import annotations

import os
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
        return Sweep(place.resolve().name, Opened(folder=place, jobs=()), named)
    origin = opened(place)
    return Run(origin, origin.read(origin.folder, named)) if origin.jobs is None else Sweep(place.stem, origin, named)


def open_run(path: str | os.PathLike[str], *, store: str | os.PathLike[str] | None = None) -> Run:
    """Open one run, as `open`.

    Raises:
        RunError: it is a sweep; or as `open`.
    """
    place = opened(Path(path))
    return Run(place, place.read(place.one_run(ONE_RUN), None if store is None else str(store)))
