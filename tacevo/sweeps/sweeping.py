"""Sweeps: many searches from one command, each in its own run directory, all over one store.

Promises: all jobs are composed before any runs; the same command, given again, does not repeat a finished job, resumes
the stopped ones and repeats the failed ones; more arms or seeds add jobs to a sweep; each job has the digest of the
same search run by itself.
"""

import hashlib
import itertools
import os
import re
import shlex
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from tacevo.choices import Varied
from tacevo.config.compose import compose, compose_estimate, spread
from tacevo.config.identity import config_hash
from tacevo.config.network_files import read_networks
from tacevo.config.schema import RunConfig
from tacevo.config.task_texts import load_task
from tacevo.environment import usable_cores
from tacevo.errors import ConfigError, RunError, telling
from tacevo.gate.extraction import as_whole
from tacevo.records import Mode
from tacevo.redaction import check_address, secret_variables
from tacevo.results.publishable import published_overrides
from tacevo.results.sweep import Standing
from tacevo.results.sweep_jobs import varied
from tacevo.runs.progress import Progress
from tacevo.runs.providers import check_temperature
from tacevo.runs.session import needed_llm
from tacevo.runs.unsent import begun_without
from tacevo.storage.sweep_directory import Job, SweepDirectory, SweepRecord, name_arm
from tacevo.sweeps.launch import Launcher, check_launcher, fitted, launch, needed_cores, split_launcher
from tacevo.sweeps.pace import seconds_left, trained
from tacevo.sweeps.prospects import shortcomings
from tacevo.sweeps.status import Status, best_in_words, check_is_run_of, read_job, status_of
from tacevo.sweeps.terms import Asked, check_varied, settled, with_reference
from tacevo.text import counted, lasting

#: The settings that distinguish jobs even if they have one value only, so that more can be added.
_OWN = ("ablation", "seed")

#: The longest part of a directory's name that comes from an arm, in characters.
_LONGEST = 80

#: The request of a command that says nothing of the terms.
_NOTHING = Asked()

#: Runs jobs to their ends; see `tacevo.sweeps.launch.launch`.
Launch = Callable[[SweepDirectory, Mapping[Job, RunConfig], Launcher, Callable[[Job], None]], None]

#: Composes a configuration from overrides.
_Read = Callable[[Sequence[str]], RunConfig]


def sweep(
    overrides: Sequence[str], into: str | None, view: Progress, run: Launch = launch, asked: Asked = _NOTHING
) -> tuple[Path, list[Status]]:
    """Run the jobs of a sweep that are not finished.

    The overrides are as for a search, with lists of values, and the options of a launcher. Without `into`, the sweep's
    directory is named after what the jobs share.

    Returns:
        The sweep's directory, and how the jobs that were asked for stand afterwards.

    Raises:
        TacevoError: see its subclasses; a mistake in any job is raised before one runs.
        KeyboardInterrupt: the user stopped it; the same command continues.
    """
    launcher, settings = split_launcher(overrides)
    check_launcher(launcher)
    if launcher.remark:
        view.say(launcher.remark)
    shared, own = part(settings, () if into is None else _own_keys(SweepDirectory(Path(into))))
    (first,) = plan(shared, own[:1]).values()
    directory = SweepDirectory(folder(shared, first) if into is None else Path(into))
    terms = settled(directory, asked, first)
    planned = plan(shared, own, terms.vary)
    for job, config in planned.items():
        check_temperature(job.overrides, config)
        needed_llm(config)
    if len(planned) < len(own):
        view.say(f"{len(own) - len(planned)} of {len(own)} jobs are the same searches as others, and run once")
    with directory.locked():
        before = directory.read().jobs if directory.is_one else ()
        _check_one_sweep(directory, shared, terms.vary, [job for job in before if job not in planned])
        known = {job.config: job for job in before}
        jobs = {known.get(job.config, job): config for job, config in planned.items()}  # whatever they were called
        statuses = {job: _check_begun(directory, job, config) for job, config in jobs.items()}
        for job, status in statuses.items():
            if status.standing is Standing.finished:
                directory.succeed(job)  # it may have been finished by `tacevo search`
        left = [config for job, config in jobs.items() if statuses[job].standing is Standing.waiting]
        asking = {(config.llm, config.temperature): config for config in left if config.llm.mode is not Mode.replay}
        for warning in dict.fromkeys(begun_without(config, map(directory.run, before)) for config in asking.values()):
            if warning:
                view.say(warning)
        every = (*before, *(job for job in jobs if job not in before))
        terms = settled(directory, asked, first)  # again, since nobody else can write now
        if not directory.is_one:
            terms = with_reference(terms, {job.arm for job in every})
            if terms.reference is None:
                view.say("no arm is called none, so nothing is tested against it: --reference ARM names another")
        directory.write(SweepRecord(overrides=shared, jobs=every, terms=terms))
        view.say(f"sweep: {directory.path} ({counted(len(jobs), 'job')}{_stage(statuses.values())})")
        for shortcoming in shortcomings(planned, every, terms.reference):
            view.say(f"warning: {shortcoming}")
        statuses.update(_run(directory, jobs, statuses, launcher=launcher, view=view, run=run))
        return directory.path, [
            status if status.standing is Standing.finished else status_of(directory, job)
            for job, status in statuses.items()
        ]


def _run(
    directory: SweepDirectory,
    jobs: Mapping[Job, RunConfig],
    statuses: Mapping[Job, Status],
    *,
    launcher: Launcher,
    view: Progress,
    run: Launch,
) -> dict[Job, Status]:
    """Run the jobs that are neither finished nor running; return how each of them ended."""
    begun = {Standing.finished, Standing.running}
    left = {job: config for job, config in jobs.items() if statuses[job].standing not in begun}
    if not left:
        return {}
    cores, needed = usable_cores(), max(needed_cores(config) for config in jobs.values())
    chosen = fitted(launcher, jobs=len(left), needed=needed, cores=cores)
    options = ", ".join(f"{name}={value}" for name, value in chosen.options.items())
    view.say(f"launcher: {chosen.cluster or 'this machine'} with {options} ({counted(cores, 'core')})")
    hidden = secret_variables(os.environ) if chosen.cluster else ()
    if hidden:
        names = ", ".join(hidden)
        view.say(
            f"not sent to the cluster: {names}; where jobs need them, hydra.launcher.setup sets them (docs/slurm.md)"
        )
    finished = sum(status.standing is Standing.finished for status in statuses.values())
    view.advance("jobs", finished, len(statuses))

    began, ended, done = datetime.now(UTC), dict[Job, Status](), list[Job]()

    def rest() -> str:
        """Say how long the others take here, at the pace of the trainings that were made."""
        if not isinstance(chosen.options.get("n_jobs"), int):
            return ""
        seconds = seconds_left(directory, left, done, ended, began=began, now=datetime.now(UTC))
        return "" if seconds is None else f", {lasting(seconds)} left"

    def show(job: Job) -> None:
        nonlocal finished
        status = ended[job] = status_of(directory, job)
        if status.standing is Standing.finished:
            finished += 1
            done.append(job)
        result = f"best {best_in_words(status)}, digest {status.digest[:12]}" if status.digest else status.reason
        view.say(f"{job.name}: {status.standing}, {result} ({finished} of {len(statuses)} jobs finished{rest()})")
        recalled = not trained(directory.run(job), left[job], began)
        view.advance("jobs", finished, len(statuses), recalled=recalled)

    with telling(
        lambda: any(status_of(directory, job).standing is not Standing.waiting for job in left) or finished > 0
    ):
        run(directory, left, chosen, show)
    return ended


def part(settings: Sequence[str], begun: Collection[str]) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Separate what all jobs share from what distinguishes them: several values, or a key of `_OWN` or `begun`.

    Returns:
        The shared overrides, and those of each job.

    Raises:
        ConfigError: an override cannot be read, names the run's directory, or holds a password.
    """
    shared, varied = [], []
    for written, values in zip(settings, spread(settings), strict=True):
        key, _, value = written.partition("=")
        check_address(value.strip("'\""), key)  # sweep.json keeps what jobs share
        if key == "run.dir":
            remedy = "name the directory of the sweep by --into"
            raise ConfigError(value, place=key, expected="no value: each job of a sweep has its own", remedy=remedy)
        if len(values) > 1 or key in _OWN or key in begun:
            varied.append(values)
        else:
            shared.append(written)
    return tuple(shared), tuple(itertools.product(*varied))


def _own_keys(directory: SweepDirectory) -> frozenset[str]:
    """Return what distinguishes the jobs of a sweep that has been begun."""
    jobs = directory.read().jobs if directory.is_one else ()
    return frozenset(override.partition("=")[0] for job in jobs for override in job.overrides)


def plan_unasked(overrides: Sequence[str], vary: Sequence[Varied]) -> dict[Job, RunConfig]:
    """Compose the jobs that a sweep would have, for its estimate: nothing is begun, and no model need be chosen.

    Raises:
        ConfigError: as `sweep`.
    """
    shared, own = part(split_launcher(overrides)[1], ())
    return plan(shared, own, vary, compose_estimate)


def plan(
    shared: Sequence[str],
    owns: Sequence[tuple[str, ...]],
    vary: Sequence[Varied] = (),
    read: _Read = compose,
) -> dict[Job, RunConfig]:
    """Compose all jobs from what they share and what is each one's own; those that are the same search are one.

    `vary` are settings that take each job's seed as their value; `read` composes.

    Returns:
        The configuration of each job.

    Raises:
        ConfigError: a job cannot be composed, or two would have the same directory; or as `check_varied`.
    """
    planned: dict[Job, RunConfig] = {}
    known = set[str]()
    for own in owns:
        try:
            config = read([*shared, *own])
            check_varied(config, vary, [*shared, *own])
            config = varied(config, vary, config.seed)
        except ConfigError as error:
            if own:
                error.place = f"{' '.join(own)}: {error.place}".removesuffix(": ")
            raise
        arm = name_arm(own)
        job = Job(name=name_job(own, config.seed), arm=arm, seed=config.seed, overrides=own, config=config_hash(config))
        if job.config not in known:
            known.add(job.config)
            planned[job] = config
    names: dict[str, Job] = {}
    for job in planned:
        other = names.setdefault(job.name, job)
        if other is not job:
            twins = " and ".join(" ".join(one.overrides) for one in (other, job))
            raise ConfigError(f"{job.name} for {twins}", place="jobs", expected="a directory name for each job")
    return planned


def name_job(own: Sequence[str], seed: int) -> str:
    """Name a job's directory: the arm, as far as a directory can have that name, and the seed.

    The name is published with the sweep, so of a path it has the last part only.
    """
    arm, shown = name_arm(own), name_arm(published_overrides(own))
    plain = re.sub(r"[^A-Za-z0-9_.]+", "-", shown).strip("-.")
    whole = shown == arm and re.fullmatch(r"[A-Za-z0-9_.= ]+", arm) and len(plain) <= _LONGEST
    name = plain if whole else f"{plain[:_LONGEST]}-{hashlib.sha256(arm.encode()).hexdigest()[:8]}"
    return f"{name}-seed{seed}"


def folder(shared: Sequence[str], config: RunConfig) -> Path:
    """Name the directory of a sweep after what its jobs share, so that the same command finds it again.

    Raises:
        ConfigError: what they share is not a configuration by itself.
    """
    try:
        common = config_hash(compose(shared))
    except ConfigError as error:
        raise ConfigError(
            f"{error}",
            place="shared overrides",
            expected="a configuration by itself, after which the directory of the sweep is named",
            remedy="name the directory by --into DIR",
        ) from error
    given = dict(override.split("=", 1) for override in shared)
    return Path("sweeps") / f"{given.get('experiment', config.task.name)}-{common[:8]}"


def _check_one_sweep(
    directory: SweepDirectory, shared: Sequence[str], vary: Sequence[Varied], before: Sequence[Job]
) -> None:
    """Check that the jobs of earlier commands stay the same searches under these shared overrides.

    All of them are checked: what is shared may be overridden by the arm of any one.
    """
    for job in before:
        try:
            same = config_hash(varied(compose([*shared, *job.overrides]), vary, job.seed)) == job.config
        except ConfigError:
            same = False
        if not same:
            began, now = (shlex.join(words) or "the defaults" for words in (directory.read().overrides, shared))
            raise RunError(
                f"{now}, under which {job.name} would be another search",
                place=str(directory.path),
                expected=f"the shared overrides of its sweep, {began}",
                remedy="choose another --into",
            )


def _check_begun(directory: SweepDirectory, job: Job, config: RunConfig) -> Status:
    """Return how a job stands, if what was begun in its directory is the job as it is asked for now."""
    begun = read_job(directory, job)
    record = begun.record
    if begun.ledger.lines and record is not None:
        check_is_run_of(job, begun)
        given = read_networks(config.search.networks, "search.networks").values() if config.search.networks else ()
        asked = tuple(replace(one, source=as_whole(one.source)) for one in given)
        if replace(load_task(config, record.data), given=asked) != record.task:
            raise RunError(
                f"a run with other texts of task {record.task.name}",
                place=str(begun.run.path),
                expected="a run with the texts in conf/",
                remedy="choose another --into",
            )
    return status_of(directory, job, begun)


def _stage(statuses: Collection[Status]) -> str:
    """Write how many jobs are in each state, if any has begun."""
    counts = [(standing, sum(status.standing is standing for status in statuses)) for standing in Standing]
    return "".join(f", {count} {standing}" for standing, count in counts if count and standing is not Standing.waiting)
