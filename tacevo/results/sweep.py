"""A sweep as records: its finished runs by arm and seed, and what is missing of it."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from tacevo.config.identity import twins
from tacevo.errors import RunError
from tacevo.evolution.run_files import finished_digest
from tacevo.results.job_scores import FailedTestError, JobScore, job_score
from tacevo.results.run import RecordedRun, read_run
from tacevo.results.sweep_jobs import misfit
from tacevo.storage.sweep_directory import UNSTATED, Job, SweepDirectory, SweepTerms

#: The arm that all others are compared with unless the sweep states another: the search as it is.
REFERENCE = "none"

#: The level of the tests of arms, after Holm's correction.
ALPHA = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class FinishedJob:
    """A finished job."""

    job: Job
    run: RecordedRun
    #: The test scores of what it found; None where it was not tested as its sweep states.
    tested: JobScore | None = None


class Standing(StrEnum):
    """The state of a job."""

    finished = "finished"
    running = "running"
    #: It failed by itself, which is a result of its arm.
    failed = "failed"
    #: It has begun, and is not running; or the scheduler ended it.
    stopped = "stopped"
    waiting = "not begun"


@dataclass(frozen=True, slots=True, kw_only=True)
class Missing:
    """A job without a result, or a finished one without a test score."""

    job: Job
    #: Finished where only its test score is missing.
    standing: Standing = Standing.finished
    #: The reason in words; empty where the state says all.
    reason: str = ""
    #: True where its search failed, or, for a job without a test score, a training of its network.
    has_failed: bool = False

    @property
    def why(self) -> str:
        """Its state, and the reason where there is one."""
        return f"{self.standing}: {self.reason}" if self.reason else self.standing.value


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedSweep:
    """The finished and the missing jobs of a sweep, each in the order of its jobs."""

    path: Path
    #: At least one.
    finished: tuple[FinishedJob, ...]
    missing: tuple[Missing, ...]
    terms: SweepTerms = UNSTATED
    #: Finished jobs that were not tested as the sweep states, where it states that.
    untested: tuple[Missing, ...] = ()

    @property
    def failed(self) -> tuple[Job, ...]:
        """Jobs whose search failed, or the test of what they found."""
        return tuple(one.job for one in (*self.missing, *self.untested) if one.has_failed)

    @property
    def twins(self) -> list[tuple[str, str]]:
        """The pairs of arms whose finished searches must be equal, whatever they find."""
        return twins((one.job.arm, one.job.seed, one.run.config) for one in self.finished)

    @property
    def not_tested(self) -> list[str]:
        """The arms whose jobs the sweep states to leave untested."""
        stated = self.terms.retraining
        jobs = [*(one.job for one in self.finished), *(one.job for one in self.missing)]
        arms = dict.fromkeys(job.arm for job in jobs)
        return [] if stated is None else [arm for arm in arms if not stated.tests(arm)]

    @property
    def task(self) -> str:
        """The task's name."""
        return self.finished[0].run.task


def load_sweep(path: Path, known: Mapping[str, RecordedRun] | None = None) -> RecordedSweep:
    """Read the finished jobs of a sweep, and why the others are missing.

    Args:
        path: the directory of the sweep.
        known: finished runs that were read already, by their jobs' names.

    Raises:
        RunError: this is not a sweep, none of its jobs is finished, an arm has a seed twice, or a run was damaged or
            edited or is not that of its job.
    """
    directory = SweepDirectory(path)
    record = directory.read()
    _check_distinct(path, record.jobs)
    retraining = record.terms.retraining
    finished, missing, untested = [], [], []
    for job in record.jobs:
        run = (known or {}).get(job.name)
        standing, reason = (Standing.finished, "") if run else state_of(directory, job)
        if standing is not Standing.finished:
            failed = standing is Standing.failed
            missing.append(Missing(job=job, standing=standing, reason=reason, has_failed=failed))
            continue
        run = run or read_run(directory.run(job).path)
        _check_run(job, run)
        tested = None
        if retraining is not None and retraining.tests(job.arm):
            try:
                tested = job_score(run, retraining)
            except RunError as error:
                failed = isinstance(error, FailedTestError)
                untested.append(Missing(job=job, reason=str(error), has_failed=failed))
        finished.append(FinishedJob(job=job, run=run, tested=tested))
    if not finished:
        raise RunError(
            f"{len(missing)} of {len(missing)} that are not finished",
            place=str(path),
            expected="at least one finished job",
            remedy="continue the sweep by the `tacevo search -m` command that began it",
        )
    return RecordedSweep(
        path=path, finished=tuple(finished), missing=tuple(missing), terms=record.terms, untested=tuple(untested)
    )


def state_of(directory: SweepDirectory, job: Job) -> tuple[Standing, str]:
    """Return the state of a job, and the reason of one that failed or that the scheduler ended."""
    run = directory.run(job)
    is_busy = run.is_busy  # before its files are read: a search that ends meanwhile is finished
    return standing_of(directory, job, is_busy=is_busy, is_finished=finished_digest(run) is not None)


def standing_of(directory: SweepDirectory, job: Job, *, is_busy: bool, is_finished: bool) -> tuple[Standing, str]:
    """Return what `state_of` does of a job whose run was read."""
    if is_finished:
        return Standing.finished, ""
    if is_busy:  # the same command repeats a job that failed
        return Standing.running, ""
    if (failure := directory.failure(job)) is not None:
        return (Standing.stopped if failure.by_scheduler else Standing.failed), failure.reason
    return (Standing.stopped if directory.run(job).ledger.exists() else Standing.waiting), ""


def _check_run(job: Job, run: RecordedRun) -> None:
    """Check that a run is that of its job."""
    if differing := misfit(job, run.config):
        field, stated, recorded = differing
        raise RunError(
            f"a run of {field} {recorded}",
            place=str(run.path),
            expected=f"{field} {stated}, as sweep.json states of job {job.name}",
            remedy="delete the directory; the command that began the sweep repeats the job",
        )


def _check_distinct(path: Path, jobs: tuple[Job, ...]) -> None:
    for (arm, seed), times in Counter((job.arm, job.seed) for job in jobs).items():
        if times > 1:
            raise RunError(
                f"{times} jobs of arm {arm} with seed {seed}",
                place=f"{path}/sweep.json",
                expected="one job for each arm and seed",
                remedy="sweep the settings in which they differ, so that each job has an arm of its own",
            )
