"""Sweeps: many searches from one command, each in its own run directory, all over one store.

Promises: all jobs are composed before any runs; the same command, given again, repeats no finished job, takes up the
stopped ones and repeats the failed ones; more arms or seeds add jobs to a sweep; each job has the digest of the same
search run by itself.
"""

import hashlib
import itertools
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tacevo.config.compose import compose, spread
from tacevo.config.identity import config_hash
from tacevo.config.recorded import read_run
from tacevo.config.schema import RunConfig
from tacevo.config.tasks import load_task
from tacevo.errors import ConfigError, RunError
from tacevo.redaction import without_password
from tacevo.runs.progress import Progress
from tacevo.runs.providers import require_temperature
from tacevo.runs.publishable import published_overrides
from tacevo.runs.session import require_means
from tacevo.storage.sweep_directory import Job, SweepDirectory, name_arm
from tacevo.sweeps.launch import Launcher, fitted, launch, require_launcher, split_launcher
from tacevo.sweeps.status import Standing, Status, status_of
from tacevo.text import counted

#: What tells jobs apart even where it has one value only, so that more can come to it.
_OWN = ("ablation", "seed")

#: The longest part of a folder's name that an arm gives, in characters.
_LONGEST = 80

#: Runs jobs to their ends; see `tacevo.sweeps.launch.launch`.
Launch = Callable[[SweepDirectory, Sequence[Job], Launcher, Callable[[], None]], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Planned:
    """A job that was asked for, and its configuration."""

    job: Job
    config: RunConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class Swept:
    """What came of a sweep."""

    directory: Path
    #: Of the jobs that this command asked for.
    statuses: tuple[Status, ...]


def sweep(overrides: Sequence[str], into: str | None, view: Progress, run: Launch = launch) -> Swept:
    """Run the jobs of a sweep that are not finished.

    Args:
        overrides: as for a search, with lists of values, and Hydra's settings of a launcher.
        into: the sweep's folder; None for one named after what the jobs share.
        view: who is told.
        run: runs the jobs.

    Raises:
        TacevoError: see its subclasses; a mistake in any job is told before one runs.
        KeyboardInterrupt: the user stopped it; the same command continues.
    """
    launcher, settings = split_launcher(overrides)
    require_launcher(launcher)
    shared, varied = part(settings, own=_OWN if into is None else (*_OWN, *_own_keys(SweepDirectory(Path(into)))))
    planned = plan(shared, varied)
    for entry in planned:
        require_temperature(entry.job.overrides, entry.config)
        require_means(entry.config)
    if len(planned) < len(varied):
        view.say(f"{len(varied) - len(planned)} of {len(varied)} jobs are the same searches as others, and run once")
    directory = SweepDirectory(folder(shared, planned[0].config) if into is None else Path(into))
    jobs = [entry.job for entry in planned]
    with directory.locked():
        before = directory.read()[1] if directory.is_one else ()
        _require_one_sweep(directory, shared, [job for job in before if job not in jobs])
        jobs = list(_known(jobs, before, directory))
        statuses = [_checked(directory, job, entry.config) for job, entry in zip(jobs, planned, strict=True)]
        for status in statuses:
            if status.standing is Standing.finished:
                directory.succeed(status.job)  # it may have been finished by hand, or its watchman killed
        directory.write(shared, [*before, *(job for job in jobs if job not in before)])
        view.say(f"sweep: {directory.path} ({counted(len(jobs), 'job')}{_stage(statuses)})")
        _run(directory, statuses, planned, launcher=launcher, view=view, run=run)
        return Swept(directory=directory.path, statuses=tuple(status_of(directory, job) for job in jobs))


def _run(
    directory: SweepDirectory,
    statuses: Sequence[Status],
    planned: Sequence[Planned],
    *,
    launcher: Launcher,
    view: Progress,
    run: Launch,
) -> None:
    """Run the jobs that are neither finished nor run by somebody else."""
    left = [status.job for status in statuses if status.standing not in {Standing.finished, Standing.running}]
    if not left:
        return
    workers, cores = max(entry.config.executor.workers for entry in planned), len(os.sched_getaffinity(0))
    chosen = fitted(launcher, jobs=len(left), workers=workers, cores=cores)
    view.say(f"launcher: {' '.join([chosen.name, *chosen.overrides])} ({counted(cores, 'core')})")
    done = sum(status.standing is Standing.finished for status in statuses)
    lookout = _Lookout(directory, left, view, done=done, total=len(statuses))
    try:
        run(directory, left, chosen, lookout.look)
    finally:
        lookout.look()


def part(settings: Sequence[str], own: Sequence[str] = _OWN) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Part what all jobs share from what tells them apart.

    Args:
        settings: as the user wrote them.
        own: keys that tell jobs apart even where they have one value here.

    Returns:
        The shared overrides, and those of each job.

    Raises:
        ConfigError: an override cannot be read, or has no place in a sweep.
    """
    shared, varied = [], []
    for written, values in zip(settings, spread(settings), strict=True):
        key = written.partition("=")[0]
        _require_place(key, written, values)
        if len(values) > 1 or key in own:
            varied.append(values)
        else:
            shared.append(written)
    return tuple(shared), tuple(itertools.product(*varied))


def _require_place(key: str, written: str, values: Sequence[str]) -> None:
    """Refuse what sweep.json must not keep, or what would not be found in it when the sweep is published.

    Args:
        key: what is set.
        written: the override.
        values: all that it stands for, each as an override of its own.

    Raises:
        ConfigError: it has no place in a sweep.
    """
    value = written.partition("=")[2].strip("'\"")
    if key == "run.dir":
        raise ConfigError(f"each job of a sweep has a folder of its own in that of the sweep (--into); got {written!r}")
    if without_password(value) != value:
        raise ConfigError(
            f"sweep.json keeps what jobs share, and {key} may hold a password; give it to the environment, as in "
            "MLFLOW_TRACKING_PASSWORD or PGPASSWORD"
        )
    if any(one.partition("=")[2].lstrip().startswith("{") for one in values):
        raise ConfigError(
            f"a sweep takes each setting by its own name; write {key}.NAME=VALUE in place of {key}={{...}}"
        )
    if "$" in written:
        raise ConfigError(
            f"{key} holds a $, which may stand for something else when the sweep goes on elsewhere; write the value "
            "itself"
        )


def _own_keys(directory: SweepDirectory) -> frozenset[str]:
    """List what tells the jobs of a sweep apart that stands in a folder already."""
    jobs = directory.read()[1] if directory.is_one else ()
    return frozenset(override.partition("=")[0] for job in jobs for override in job.overrides)


def plan(shared: Sequence[str], varied: Sequence[tuple[str, ...]]) -> tuple[Planned, ...]:
    """Compose all jobs; those that are the same search are one.

    Args:
        shared: overrides of all jobs.
        varied: those of each.

    Raises:
        ConfigError: a job cannot be composed, or two would have the same folder.
    """
    planned: dict[str, Planned] = {}
    for own in varied:
        try:
            config = compose([*shared, *own])
        except ConfigError as error:
            raise ConfigError(f"{' '.join(own)}: {error}" if own else str(error)) from error
        arm = name_arm(own)
        job = Job(name=name_job(own, config.seed), arm=arm, seed=config.seed, overrides=own, config=config_hash(config))
        planned.setdefault(job.config, Planned(job=job, config=config))
    names: dict[str, Job] = {}
    for entry in planned.values():
        other = names.setdefault(entry.job.name, entry.job)
        if other is not entry.job:
            twins = " and ".join(" ".join(job.overrides) for job in (other, entry.job))
            raise ConfigError(f"a sweep needs a folder for each job; {twins} would share {entry.job.name}")
    return tuple(planned.values())


def name_job(own: Sequence[str], seed: int) -> str:
    """Name a job's folder: the arm, as far as a folder can be called that, and the seed.

    What belongs to one machine is left out, such as a path but for its last part: the name is published with the sweep.
    """
    arm, shown = name_arm(own), name_arm(published_overrides(own))
    plain = re.sub(r"[^A-Za-z0-9_.]+", "-", shown).strip("-.")
    whole = shown == arm and re.fullmatch(r"[A-Za-z0-9_.= ]+", arm) and len(plain) <= _LONGEST
    told = plain if whole else f"{plain[:_LONGEST]}-{hashlib.sha256(arm.encode()).hexdigest()[:8]}"
    return f"{told}-seed{seed}"


def folder(shared: Sequence[str], config: RunConfig) -> Path:
    """Name the folder of a sweep after what its jobs share, so that the same command finds it again.

    Args:
        shared: overrides of all jobs.
        config: of any job.

    Raises:
        ConfigError: what they share is no configuration by itself.
    """
    try:
        common = config_hash(compose(shared))
    except ConfigError as error:
        raise ConfigError(
            f"a sweep's folder is named after what its jobs share, and here that is no configuration ({error}); name "
            "the folder by --into"
        ) from error
    given = dict(override.split("=", 1) for override in shared)
    return Path("sweeps") / f"{given.get('experiment', config.task.name)}-{common[:8]}"


def _require_one_sweep(directory: SweepDirectory, shared: Sequence[str], before: Sequence[Job]) -> None:
    """Refuse shared overrides under which jobs that stand in a sweep would be others.

    Args:
        directory: the sweep's.
        shared: overrides of all jobs, now.
        before: jobs of earlier commands, all of them: what is shared may be overridden by the arm of any one.
    """
    for job in before:
        try:
            same = config_hash(compose([*shared, *job.overrides])) == job.config
        except ConfigError:
            same = False
        if not same:
            began, now = (" ".join(words) or "the defaults" for words in (directory.read()[0], shared))
            raise RunError(
                f"{directory.path} holds a sweep over {began}, and {job.name} would be another search under {now}; "
                "choose another --into"
            )


def _known(jobs: Sequence[Job], before: Sequence[Job], directory: SweepDirectory) -> tuple[Job, ...]:
    """Find jobs among those of before, by what they are, whatever they were called.

    Raises:
        RunError: a job's folder belongs to another job.
    """
    by_config: Mapping[str, Job] = {job.config: job for job in before}
    taken = {job.name for job in before}
    for job in jobs:
        if job.config not in by_config and job.name in taken:
            raise RunError(
                f"{directory.run(job).path} belongs to another configuration of {job.arm}, seed {job.seed}, than this "
                "command's; choose another --into"
            )
    return tuple(by_config.get(job.config, job) for job in jobs)


def _checked(directory: SweepDirectory, job: Job, config: RunConfig) -> Status:
    """Tell how a job stands, if what was begun in its folder is the job as it is asked for now.

    Raises:
        RunError: it is another configuration's, or the task's texts have changed since.
    """
    run = directory.run(job)
    begun = run.ledger.exists() and bool(run.read_ledger())
    if not begun or not (run.path / "run.json").exists():
        return status_of(directory, job)
    recorded, task, facts = read_run(run)
    if config_hash(recorded) != job.config:
        raise RunError(f"{run.path} holds another configuration's run; move that folder away, or choose another --into")
    if load_task(config, facts) != task:
        raise RunError(
            f"{run.path} was run with other texts of task {task.name} than conf/ has now; choose another --into"
        )
    return status_of(directory, job)


def _stage(statuses: Sequence[Status]) -> str:
    """Say how many jobs stand how, where any has begun."""
    counts = [(standing, sum(status.standing is standing for status in statuses)) for standing in Standing]
    return "".join(f", {count} {standing}" for standing, count in counts if count and standing is not Standing.waiting)


class _Lookout:
    """Tells a view of each job that ends.

    Args:
        directory: the sweep's.
        jobs: those that are launched.
        view: who is told.
        done: how many of all are finished before.
        total: of all.
    """

    def __init__(
        self, directory: SweepDirectory, jobs: Sequence[Job], view: Progress, *, done: int, total: int
    ) -> None:
        self._directory = directory
        self._left = {job: directory.endings(job) for job in jobs}
        self._view = view
        self._done = done
        self._total = total
        view.advance("jobs", done, total)

    def look(self) -> None:
        """Tell of the jobs that have ended since the last look."""
        for job, before in list(self._left.items()):
            if self._directory.endings(job) == before:
                continue
            status = status_of(self._directory, job)
            if status.standing is Standing.running:
                continue
            del self._left[job]
            self._done += status.standing is Standing.finished
            found = f"best {status.best:.4g}, digest {status.digest[:12]}" if status.digest else status.reason
            self._view.say(f"{job.name}: {status.standing}, {found} ({self._done} of {self._total} jobs finished)")
            self._view.advance("jobs", self._done, self._total)
