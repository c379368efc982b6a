"""A run or a sweep of runs, opened from its directory or from a bundle.

What it promises: a bundle is read in memory, and nothing of it is written; errors name the file and the member. The
commands see runs, and not where they came from.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tacevo.bundles.format import JOBS, SWEEP, read_bundle, refusing
from tacevo.choices import Confinement
from tacevo.errors import BundleError, RunError
from tacevo.evolution.run_files import finished_digest
from tacevo.results.run import RecordedRun, read_run
from tacevo.results.settings import settings_of
from tacevo.results.table_header import is_table
from tacevo.storage.array_store import KIND
from tacevo.storage.members import Member
from tacevo.storage.places import check_place
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.sweep_directory import Job, SweepDirectory, SweepRecord
from tacevo.text import listed

#: The directory of stores on this machine, whatever a bundle says of its author's.
HERE = "cache"


@dataclass(frozen=True, slots=True, kw_only=True)
class Opened:
    """A run or a sweep."""

    #: The directory of the run or sweep.
    folder: Path
    #: The directory of the stores of a bundle or of a sweep; None where one run's record names them.
    entries: Path | None = None
    #: Names of a sweep's jobs and of their directories; None for one run.
    jobs: tuple[str, ...] | None = None
    #: All members of a bundle; None if it is not a bundle.
    root: Member | None = None
    #: The digest of a bundle, also where this is one job of it: SHA-256 of its manifest, which stands for every byte of
    #: it.
    digest: str | None = None
    #: Whether its stores keep the test predictions of studies: the bundle of a sweep leaves them out.
    has_predictions: bool = True

    @property
    def store(self) -> Path:
        """The directory of its stores."""
        return _store_of(self) if self.entries is None else self.entries

    @property
    def runs(self) -> tuple[Path, ...]:
        """The directories of its runs: one, or those of a sweep's jobs."""
        return (self.folder,) if self.jobs is None else tuple(self.folder / job for job in self.jobs)

    def one_run(self, remedy: str) -> Path:
        """Return the directory of its only run; `remedy` is what a user who gave a sweep can do instead.

        Raises:
            RunError: it is a sweep.
        """
        if self.jobs is not None:
            raise RunError(f"a sweep of {len(self.jobs)}", expected="one run", remedy=remedy)
        return self.folder

    def job(self, name: str) -> "Opened":
        """Return one run of a published sweep, by the name of its job."""
        return replace(self, folder=self.folder / name, jobs=None, root=None)

    def read(self, run: Path, store: str | None = None) -> RecordedRun:
        """Read one of its runs; `store` is where the stores lie, if not where they were found.

        Those of a bundle are its own entries; images of its data set are then made and kept in `cache`.

        Raises:
            TacevoError: as `read_run`.
        """
        packed = self.entries if store is None and self.digest is not None else None
        own = None if self.entries is None else str(self.entries)
        recorded = read_run(run, store or (own if packed is None else HERE))
        return replace(recorded, packed=packed, has_predictions=self.has_predictions)


def opened(path: Path) -> Opened:
    """Open the directory of a run or a sweep; or a bundle, compared with its manifest.

    `SWEEP.zip/JOB` is one run of a sweep's bundle.

    Raises:
        BundleError: the bundle is damaged, or holds what none should; the message names the place.
        RunError: it is neither a run's or a sweep's directory nor a file, or is a table; or the sweep has no such job.
    """
    check_place(path)
    if path.parent.is_file():
        return opened(path.parent).job(path.name)
    if path.is_file() and is_table(path):
        remedy = "`tacevo.open_table(FILE)` opens it, `tacevo replay FILE` verifies it"
        raise RunError("the table of a space", place=str(path), expected="a run or a sweep", remedy=remedy)
    return _read(path) if path.is_file() else located(path)


def located(path: Path) -> Opened:
    """Find what lies in the directory of a run or of a sweep.

    Raises:
        RunError: it is neither, or a sweep that is not finished, or one whose runs have several stores.
    """
    jobs = None
    if (directory := SweepDirectory(path)).is_one:
        sweep = _read_sweep(path)
        jobs = tuple(job.name for job in sweep.jobs)
        _check_finished(directory, sweep.jobs)
    elif not (path / "run.json").exists():
        RunDirectory(path).read_run()  # which says what is missing
    place = Opened(folder=path, jobs=jobs)
    return place if jobs is None else replace(place, entries=_store_of(place))


def _read(source: Path) -> Opened:
    """Read and verify a bundle; find what is in it."""
    root, store, digest = read_bundle(source)
    place = Opened(folder=root / SWEEP, entries=store, root=root, digest=digest)
    if not (root / JOBS).exists():
        run = root / "run"
        return replace(place, folder=run.called(_name(run)))  # tables and figures bear the name of the run
    with refusing():
        sweep = _read_sweep(place.folder)
    jobs = tuple(job.name for job in sweep.jobs)
    for name in sorted(set(jobs) ^ {path.name for path in place.folder.iterdir() if path.is_dir()}):
        what = f"no directory of the job {name!r}" if name in jobs else f"directory {name!r}, which is not a job"
        raise BundleError(what, place=f"{root / JOBS}", expected="one directory for each job")
    if (root / JOBS).read_bytes() != sweep.text.encode():
        expected = "the text that `tacevo publish` writes of these jobs"
        raise BundleError("the same jobs in another text: it was edited", place=f"{root / JOBS}", expected=expected)
    return replace(place, jobs=jobs, has_predictions=(store / KIND).exists())


def _read_sweep(folder: Path) -> SweepRecord:
    """Read a sweep of at least one job, each of another name."""
    sweep = SweepDirectory(folder).read()
    names = [job.name for job in sweep.jobs]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice or not names:
        got = f"{twice[0]!r} twice" if twice else "no job"
        raise RunError(got, place=f"{folder}/sweep.json", expected="at least one job, each of another name")
    return sweep


def _check_finished(directory: SweepDirectory, jobs: Sequence[Job]) -> None:
    """Check that every job of a sweep is finished: results of a part of it would be another sweep's."""
    unfinished = []
    for job in jobs:
        if finished_digest(directory.run(job)) is None:
            failure = directory.failure(job)
            unfinished.append(job.name if failure is None else f"{job.name} (failed: {failure.reason})")
    if unfinished:
        raise RunError(
            f"unfinished ones: {', '.join(unfinished)}",
            place=str(directory.path),
            expected="finished jobs only",
            remedy="repeat the `tacevo search -m` command that began the sweep; it continues them",
        )


def _store_of(place: Opened) -> Path:
    """Read which stores the runs have."""
    roots = set()
    for run in place.runs:
        config = settings_of(RunDirectory(run))
        roots.add(Path(config.store.root))
    if len(roots) > 1:
        raise RunError(
            listed(sorted(map(str, roots))), place=str(place.folder), expected="runs with one store.root for all"
        )
    return roots.pop()


def _name(run: Path) -> str:
    """Read the name of a run, which becomes that of a directory."""
    with refusing():
        name = RunDirectory(run).read_run().name
    if not name.isprintable() or "/" in name or name in {"", ".", ".."} or len(name.encode()) > 255:
        got = json.dumps(name)[:100]
        raise BundleError(got, place=f"{run}/run.json, name", expected="the name of a directory")
    return name


def check_walls(place: Opened) -> None:
    """Refuse to run the candidates of a bundle that would itself take the sandbox's walls down.

    Raises:
        BundleError: it asks for `sandbox.require=none`, as a run on a GPU does; or its configuration cannot be read.
    """
    if place.digest is None:
        return
    for run in place.runs:
        with refusing():
            config = settings_of(RunDirectory(run))
        if config.sandbox.require is Confinement.none:
            raise BundleError(
                "sandbox.require=none, with which its candidates would run here without walls",
                expected="a published run whose candidates can be confined",
                remedy="if you trust every source in it, unpack it and give its directory run instead"
                if place.jobs is None and place.root is not None
                else "",
            )
