"""The state of the jobs of a sweep, read from their run directories."""

import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

from tacevo.config.identity import config_hash
from tacevo.config.plain import from_plain
from tacevo.errors import RunError, TacevoError
from tacevo.evolution.chance import is_at_chance
from tacevo.evolution.lines import GenerationLine
from tacevo.evolution.run_files import Line, is_finished, read_begun, read_ledger
from tacevo.results.sweep import Standing, standing_of
from tacevo.rounding import significant
from tacevo.storage.ledger import Sealed
from tacevo.storage.run_directory import RunDirectory, RunRecord
from tacevo.storage.sweep_directory import Job, SweepDirectory
from tacevo.text import counted, table, unbroken


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """The state of one job, and its results so far."""

    job: Job
    standing: Standing
    #: The number of lines of its ledger.
    lines: int = 0
    #: The best validation loss of its last whole generation; None before the first.
    best: float | None = None
    #: Whether that is at chance (`tacevo.evolution.chance`), of a finished job.
    at_chance: bool = False
    #: The digest of a finished job; else empty.
    digest: str = ""
    #: The reason of a failed job; else empty.
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Begun:
    """The content of a job's run directory, read once."""

    run: RunDirectory
    is_busy: bool
    #: The content of run.json; None where none was written yet.
    record: RunRecord | None
    ledger: Sealed[Line]


def read_job(directory: SweepDirectory, job: Job) -> Begun:
    """Read what lies in the run directory of a job, be it nothing.

    Raises:
        RunError: a file is damaged.
    """
    run = directory.run(job)
    # These three in this order: a search that ends meanwhile is finished, and grows no more.
    return Begun(run=run, is_busy=run.is_busy, record=read_begun(run), ledger=read_ledger(run))


def status_of(directory: SweepDirectory, job: Job, begun: Begun | None = None) -> Status:
    """Return how a job stands; a run directory that cannot be read is a failure with its reason.

    `begun` is what lies there, if it was read.
    """
    try:
        begun = begun or read_job(directory, job)
        ends, lines = is_finished(begun.record, begun.ledger), begun.ledger.lines
        standing, reason = standing_of(directory, job, is_busy=begun.is_busy, is_finished=ends)
        if lines:
            check_is_run_of(job, begun)
    except TacevoError as error:
        return Status(job=job, standing=Standing.failed, reason=str(error))
    best = next((line.best for line in reversed(lines) if isinstance(line, GenerationLine)), None)
    return Status(
        job=job,
        standing=standing,
        lines=len(lines),
        best=best,
        at_chance=ends and begun.record is not None and is_at_chance(best, begun.record.trivial),
        digest=begun.ledger.digest if ends else "",
        reason=reason,
    )


def check_is_run_of(job: Job, begun: Begun) -> None:
    """Check that a run, begun or finished, has the configuration of a job.

    Raises:
        RunError: it has another one; or as `RunDirectory.read_run`.
    """
    record = begun.record or begun.run.read_run()  # which says what is missing
    if (came := config_hash(from_plain(record.config))) != job.config:
        raise RunError(
            f"a run whose configuration has the hash {came[:12]}",
            place=str(begun.run.path),
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


def continuing(directory: SweepDirectory, tacevo: str) -> str:
    """Return the command that runs what a sweep has not finished, whose options of a launcher are not recorded.

    Jobs that are not every combination of their settings have no command together; then it is said in words.

    Args:
        directory: of the sweep.
        tacevo: the program, as its user types it.
    """
    record = directory.read()
    into = f"--into {shlex.quote(str(directory.path))}"
    values: dict[str, list[str]] = {}
    for job in record.jobs:
        for override in job.overrides:
            key, _, value = override.partition("=")
            if value not in values.setdefault(key, []):
                values[key].append(value)
    asked = {frozenset(job.overrides) for job in record.jobs}
    every = product(*([f"{key}={value}" for value in known] for key, known in values.items()))
    if {frozenset(one) for one in every} != asked:
        return f"the command that began the sweep, with {into}: it runs what is not finished"
    words = [*record.overrides, *(f"{key}={','.join(known)}" for key, known in values.items())]
    return f"{tacevo} search -m {shlex.join(words)} {into}"


def _row(status: Status) -> list[str]:
    digest = status.digest[:12] or "-"
    job = status.job
    return [job.name, job.arm, str(job.seed), status.standing.value, str(status.lines), best_in_words(status), digest]


def best_in_words(status: Status) -> str:
    """Write the best loss of a job, and that it is at chance where it is."""
    if status.best is None:
        return "-"
    return f"{significant(status.best)}, at chance" if status.at_chance else significant(status.best)
