"""A run or a sweep of runs, opened wherever it lies: in its folder, or in a bundle.

What it promises: a bundle lies in a private folder, which is removed however the work ends, but for a killed process;
messages name the file and not that folder. The rest of the commands see runs, and not where they came from.
"""

import contextlib
import json
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from tacevo.bundles.format import JOBS, SWEEP, unpack_verified
from tacevo.choices import Confinement, Device
from tacevo.config.recorded import read_run
from tacevo.errors import BundleError, RunError, TacevoError
from tacevo.search.files import finished_digest
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.sweep_directory import SweepDirectory, sweep_text

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class Opened:
    """A run or a sweep, wherever it lies."""

    #: Its folder.
    folder: Path
    #: The folder of its stores.
    store: Path
    #: Names of a sweep's jobs, each that of a run's folder in the sweep's; None for one run.
    jobs: tuple[str, ...] | None = None
    #: The folder of all members of a bundle, where those of `folder` lie deeper; None for what is no bundle.
    root: Path | None = None
    #: Of a bundle: SHA-256 of its manifest, which stands for every byte of it.
    digest: str | None = None

    @property
    def runs(self) -> tuple[Path, ...]:
        """The folders of its runs: one, or those of a sweep's jobs."""
        return (self.folder,) if self.jobs is None else tuple(self.folder / job for job in self.jobs)

    def one_run(self, remedy: str) -> Path:
        """Give the folder of its only run.

        Args:
            remedy: what a user who gave a sweep may do instead.

        Raises:
            RunError: it is a sweep.
        """
        if self.jobs is not None:
            raise RunError(f"one run was expected, and this is a sweep of {len(self.jobs)}; {remedy}")
        return self.folder


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Opened]:
    """Open the folder of a run or a sweep, or a bundle, verified against its manifest, in a private temporary folder.

    Args:
        path: the folder or the file.

    Raises:
        BundleError: the bundle is damaged, or holds what none should; the message names the place.
        RunError: it is neither a run's or a sweep's folder nor a file.
    """
    if not path.exists():
        raise RunError("it does not exist", place=str(path), remedy="name the directory of a run, or a bundle")
    if not path.is_file():
        yield located(path)
        return
    with private_folder(path) as folder:
        yield _unpacked(path, folder)


def located(path: Path) -> Opened:
    """Find what lies in the folder of a run or of a sweep.

    Raises:
        RunError: it is neither, or a sweep that is not finished, or one whose runs have several stores.
    """
    jobs = _jobs(path) if SweepDirectory(path).is_one else None
    if jobs is not None:
        _insist_on_finished(SweepDirectory(path))
    found = Opened(folder=path, store=path, jobs=jobs)
    return replace(found, store=_store_of(found))


def over_runs(found: Opened, act: Callable[[Path], T], say: Callable[[str], object]) -> tuple[T, ...]:
    """Do something with every run in turn; of a sweep, what is said and raised names the job.

    Args:
        found: one run, or a sweep.
        act: takes the folder of a run.
        say: is told which job's turn it is.
    """
    if found.jobs is None:
        return (act(found.folder),)
    done = []
    for number, (job, run) in enumerate(zip(found.jobs, found.runs, strict=True), start=1):
        say(f"job {job} ({number} of {len(found.jobs)})")
        try:
            done.append(act(run))
        except TacevoError as error:
            raise type(error)(f"job {job}: {error}") from error
    return tuple(done)


@contextlib.contextmanager
def private_folder(place: Path) -> Iterator[Path]:
    """Give a temporary folder that stands for a place; messages of errors name that place instead.

    It is this user's alone, and removed at the end, also where that is an error or Ctrl-C.
    """
    with tempfile.TemporaryDirectory(prefix="tacevo-") as folder, standing_for(Path(folder), place):
        yield Path(folder)


@contextlib.contextmanager
def standing_for(folder: Path, place: Path) -> Iterator[None]:
    """Let messages of errors name a place where they would name a folder that stands for it."""
    try:
        yield
    except TacevoError as error:
        raise type(error)(str(error).replace(str(folder), str(place))) from error


def _unpacked(source: Path, folder: Path) -> Opened:
    """Unpack and verify a bundle; find what is in it."""
    digest = unpack_verified(source, folder)
    found = Opened(folder=folder / SWEEP, store=folder / "store", root=folder, digest=digest)
    if not (folder / JOBS).exists():
        run = folder / "run" / _name(folder / "run")
        (folder / "run").rename(folder / "moved")
        run.parent.mkdir()
        (folder / "moved").rename(run)  # tables and figures bear the name of the run's folder
        return replace(found, folder=run)
    try:
        jobs = _jobs(found.folder)
    except RunError as error:
        raise BundleError(str(error)) from error
    for name in sorted(set(jobs) ^ {path.name for path in found.folder.iterdir() if path.is_dir()}):
        what = "is a job, and its run is not there" if name in jobs else "is there, and is no job"
        raise BundleError(f"{source}/{JOBS}: {name!r} {what}")
    if (folder / JOBS).read_bytes() != sweep_text(*SweepDirectory(found.folder).read()).encode():
        raise BundleError(f"{source}/{JOBS} is not written as `tacevo publish` writes it, so it was edited")
    return replace(found, jobs=jobs)


def _jobs(folder: Path) -> tuple[str, ...]:
    """Read the names of a sweep's jobs.

    Raises:
        RunError: sweep.json is damaged, has no jobs, or names one twice.
    """
    _, jobs = SweepDirectory(folder).read()
    names = tuple(job.name for job in jobs)
    if not names:
        raise RunError(f"{folder}/sweep.json lists no job; a sweep has one at least")
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise RunError(f"{folder}/sweep.json lists the job {twice[0]!r} twice")
    return names


def _insist_on_finished(directory: SweepDirectory) -> None:
    """See that every job of a sweep came to its end: results of a part of it would be another sweep's.

    Raises:
        RunError: some did not; the message names them all.
    """
    unfinished = []
    for job in directory.read()[1]:
        if finished_digest(directory.run(job)) is None:
            reason = directory.failure(job)
            unfinished.append(job.name if reason is None else f"{job.name} (failed: {reason})")
    if unfinished:
        raise RunError(
            f"jobs of {directory.path} are not finished: {', '.join(unfinished)}; the `tacevo search -m` command that "
            "began the sweep takes them up"
        )


def _store_of(found: Opened) -> Path:
    """Read where the stores of what lies in a folder are.

    Raises:
        RunError: this is no run directory, or a sweep whose runs have several stores.
    """
    roots = set()
    for run in found.runs:
        config, _, _ = read_run(RunDirectory(run))
        roots.add(Path(config.store.root))
    if len(roots) > 1:
        listed = ", ".join(sorted(map(str, roots)))
        raise RunError(f"the runs of {found.folder} keep their answers in several stores: {listed}; a sweep has one")
    return roots.pop()


def _name(run: Path) -> str:
    """Read the name of a run, which becomes that of a folder."""
    try:
        name = RunDirectory(run).read_run().name
    except RunError as error:
        raise BundleError(str(error)) from error
    if not name.isprintable() or "/" in name or name in {"", ".", ".."} or len(name.encode()) > 255:
        raise BundleError(f"{run}/run.json: the name of a run must be that of a folder; got {json.dumps(name)[:100]}")
    return name


def insist_on_walls(found: Opened) -> None:
    """Refuse to run the candidates of a bundle that would itself take the sandbox's walls down.

    Raises:
        BundleError: it asks for `sandbox.require=none`, or for a GPU, whose driver works behind no walls; or its
            configuration cannot be read.
    """
    if found.root is None:
        return
    for run in found.runs:
        try:
            config, _, _ = read_run(RunDirectory(run))
        except RunError as error:
            raise BundleError(str(error)) from error
        asked = []
        if config.sandbox.require is Confinement.none:
            asked.append("sandbox.require=none")
        if config.training.device is not Device.cpu:
            asked.append(f"training.device={config.training.device}")
        if asked:
            raise BundleError(
                f"the published run has {' and '.join(asked)}, with which its candidates would run here without walls; "
                f"if you trust every source in it, unpack it and give its folder {run.relative_to(found.root)} instead"
            )
