"""The state of the jobs of a sweep, read from their run directories."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from tacevo.config.identity import config_hash
from tacevo.config.plain import from_plain
from tacevo.errors import RunError, TacevoError
from tacevo.evolution.chance import is_at_chance
from tacevo.evolution.lines import GenerationLine
from tacevo.evolution.run_files import read_ledger
from tacevo.results.sweep import Standing, standing_of
from tacevo.rounding import significant
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.sweep_directory import Job, SweepDirectory
from tacevo.text import counted, table, unbroken


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """The state of one job, and its results so far."""

    job: Job
    standing: Standing
    #: Of its ledger.
    lines: int = 0
    #: The best validation loss of its last whole generation; None before the first.
    best: float | None = None
    #: Whether that is at chance (`tacevo.evolution.chance`), of a finished job.
    at_chance: bool = False
    #: Of a finished job; else empty.
    digest: str = ""
    #: Of a failed job; else empty.
    reason: str = ""


def status_of(directory: SweepDirectory, job: Job) -> Status:
    """Return how a job stands; a run directory that cannot be read is a failure with its reason."""
    run = directory.run(job)
    try:
        is_busy = run.is_busy  # these three in this order: a search that ends meanwhile is finished, and grows no more
        digest = run.read_run().digest if (run.path / "run.json").exists() else None
        ledger = read_ledger(run)
        is_finished = digest is not None and digest == ledger.digest
        standing, reason = standing_of(directory, job, is_busy=is_busy, is_finished=is_finished)
        lines = ledger.lines
        if lines:
            check_is_run_of(job, run)
        best = next((line.best for line in reversed(lines) if isinstance(line, GenerationLine)), None)
        at_chance = is_finished and is_at_chance(best, run.read_run().trivial)
    except TacevoError as error:
        return Status(job=job, standing=Standing.failed, reason=str(error))
    return Status(
        job=job,
        standing=standing,
        lines=len(lines),
        best=best,
        at_chance=at_chance,
        digest=ledger.digest if is_finished else "",
        reason=reason,
    )


def check_is_run_of(job: Job, run: RunDirectory) -> None:
    """Check that a run, begun or finished, has the configuration of a job.

    Raises:
        RunError: it has another one; or as `RunDirectory.read_run`.
    """
    if (came := config_hash(from_plain(run.read_run().config))) != job.config:
        raise RunError(
            f"a run whose configuration has the hash {came[:12]}",
            place=str(run.path),
            expected=f"a run of the job {job.name}, whose configuration has the hash {job.config[:12]}",
            remedy="move that directory away, or choose another --into",
        )


def describe_jobs(statuses: Sequence[Status]) -> str:
    """Write how many jobs are in each state, a row for each job, and the reason of each that failed."""
    counts = Counter(status.standing for status in statuses)
    states = ", ".join(f"{counts[standing]} {standing}" for standing in Standing if counts[standing])
    rows = [_row(status) for status in statuses]
    reasons = [unbroken(f"{status.job.name}: {status.reason}") for status in statuses if status.reason]
    header = ["job", "arm", "seed", "state", "lines", "best", "digest"]
    return "\n\n".join([f"{counted(len(statuses), 'job')}: {states or 'none'}", table(header, rows), *reasons])


def _row(status: Status) -> list[str]:
    digest = status.digest[:12] or "-"
    job = status.job
    return [job.name, job.arm, str(job.seed), status.standing.value, str(status.lines), best_in_words(status), digest]


def best_in_words(status: Status) -> str:
    """Write the best loss of a job, and that it is at chance where it is."""
    if status.best is None:
        return "-"
    return f"{significant(status.best)}, at chance" if status.at_chance else significant(status.best)
