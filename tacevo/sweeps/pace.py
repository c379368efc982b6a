"""How long the rest of a sweep takes, by the trainings that its jobs made.

A job may recall most of its trainings, or all: they are in the store that the jobs share. Such a job is over in seconds
and says nothing of the others, so trainings that were made are counted, and not jobs.
"""

from collections.abc import Collection, Mapping
from datetime import datetime, timedelta

from tacevo.config.schema import RunConfig
from tacevo.evolution.lines import CandidateLine
from tacevo.evolution.run_files import read_ledger
from tacevo.storage.run_directory import RunDirectory, Timing
from tacevo.storage.sweep_directory import Job, SweepDirectory


def seconds_left(
    directory: SweepDirectory,
    jobs: Mapping[Job, RunConfig],
    finished: Collection[Job],
    ended: Collection[Job],
    *,
    began: datetime,
    now: datetime,
) -> float | None:
    """Return how many seconds the jobs that have not ended take at the pace of the trainings so far.

    It is a generous guess: each is thought to train as many networks as those that finished, and to recall none.

    Args:
        directory: of the sweep.
        jobs: that were given to be run, with their configurations.
        finished: those of them that finished.
        ended: these, and those that failed.
        began: the time when they were given, in UTC.
        now: the present time.

    Returns:
        None where no job finished, nothing was trained since they were given, or all have ended.
    """
    others = [job for job in jobs if job not in ended]
    timings = {job: _timings(directory.run(job)) for job in jobs}
    made = [one for job, config in jobs.items() for one in timings[job] if _is_made(one, config, began)]
    if not (finished and others and made):
        return None
    first = min(datetime.fromisoformat(one.at) - timedelta(seconds=one.seconds or 0) for one in made)
    each = sum(_units(directory.run(job), jobs[job]) for job in finished) / len(finished)
    rest = sum(max(0.0, each - len(timings[job])) for job in others)
    return (now - first).total_seconds() * rest / len(made)


def trained(run: RunDirectory, config: RunConfig, began: datetime) -> bool:
    """Answer whether a job made a training since that time, or looked something up in a table."""
    return any(_is_made(one, config, began) for one in _timings(run))


def _timings(run: RunDirectory) -> list[Timing]:
    """Return the last line of each candidate."""
    return [*{one.id: one for one in run.read_timings() if one.id is not None}.values()]


def _is_made(one: Timing, config: RunConfig, began: datetime) -> bool:
    """Answer whether a training was made since the jobs were given; of a search with a table, whether it was looked up.

    A table's scores take no processor time, and none of them is recalled.
    """
    is_work = one.cpu_seconds is not None or config.data.facts.is_looked_up
    return is_work and datetime.fromisoformat(one.at) >= began


def _units(run: RunDirectory, config: RunConfig) -> int:
    """Count what a finished job has of what `_is_made` counts, made or recalled."""
    lines = [line for line in read_ledger(run).lines if isinstance(line, CandidateLine)]
    return len(lines) if config.data.facts.is_looked_up else sum(line.evaluation is not None for line in lines)
