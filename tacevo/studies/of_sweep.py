"""`tacevo study sweep=DIR`: the best networks of every job of a sweep, trained fully with fresh seeds and tested.

`tacevo noise sweep=DIR`: a noise run of every job, which states nothing and decides nothing.

Each job gets an ordinary study, of the baseline and its best elites, in its own directory. What is stated once for all
of them, how many elites, seeds, epochs and what `best` means, is written into sweep.json before the first training, so
that `tacevo ablations` knows which studies count, whatever other studies the runs have.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from tacevo.config.study import NoiseConfig, StudyConfig
from tacevo.errors import RunError
from tacevo.evolution.run_files import finished_digest
from tacevo.results.study_directory import is_stated, studies_of
from tacevo.runs.progress import Progress
from tacevo.storage.sweep_directory import Job, Retraining, SweepDirectory, naming
from tacevo.studies.study import Studied, estimate_noise, study


def study_sweep(path: Path, config: StudyConfig, view: Progress) -> tuple[list[Studied], list[str]]:
    """Study the best elites of each finished job of a sweep in a directory, or resume such studies.

    Returns:
        The studies of the finished jobs, in the order of these, at least one; and the names of the unfinished jobs.

    Raises:
        TacevoError: see its subclasses, with the job named; the trainings that ended are kept.
        KeyboardInterrupt: the user stopped it; the same command continues.
    """
    directory = SweepDirectory(path)
    sweep = directory.read()
    finished = _finished(directory, sweep.jobs)
    retraining = Retraining(elites=config.elites, seeds=config.seeds, epochs=config.epochs, choose=config.choose)
    if sweep.terms.retraining != retraining:
        _state(directory, retraining)
    return _each(directory, finished, lambda run: study(replace(config, run=run, sweep=None), view), view)


def estimate_noise_of_sweep(path: Path, config: NoiseConfig, view: Progress) -> tuple[list[Studied], list[str]]:
    """Train the elites of each finished job again, or resume such noise runs; as `study_sweep`."""
    directory = SweepDirectory(path)
    finished = _finished(directory, directory.read().jobs)
    return _each(directory, finished, lambda run: estimate_noise(replace(config, run=run, sweep=None), view), view)


def _finished(directory: SweepDirectory, jobs: Sequence[Job]) -> list[Job]:
    """Return the finished jobs of a sweep, at least one."""
    finished = [job for job in jobs if finished_digest(directory.run(job)) is not None]
    if not finished:
        got, expected = f"{len(jobs)} of {len(jobs)} that are not finished", "at least one finished job"
        raise RunError(got, place=str(directory.path), expected=expected, remedy="continue the sweep")
    return finished


def _each(
    directory: SweepDirectory, finished: Sequence[Job], train: Callable[[str], Studied], view: Progress
) -> tuple[list[Studied], list[str]]:
    """Do the same for the run of each job, one after another; an error names the job."""
    studies = []
    for number, job in enumerate(finished, start=1):
        view.say(f"job {job.name} ({number} of {len(finished)})")
        with naming(job.name):
            studies.append(train(str(directory.run(job).path)))
        view.advance("jobs", number, len(finished))
    jobs = directory.read().jobs  # with those that were added meanwhile
    return studies, [job.name for job in jobs if job not in finished]


def _state(directory: SweepDirectory, retraining: Retraining) -> None:
    """Write into sweep.json how its jobs are tested, before the first of them is.

    Raises:
        RunError: a job was tested as stated otherwise, or so before it was stated; or another process holds the sweep,
            which has to be written.
    """
    with directory.locked():
        sweep = directory.read()  # as it is now that nobody else can write
        stated = sweep.terms.retraining
        expected = remedy = ""
        if stated is not None and _is_tested(directory, sweep.jobs, stated):
            expected = f"{stated.settings}, as stated before its jobs were tested"
            remedy = "set these values; `tacevo study run=` studies single jobs under others"
        elif _is_tested(directory, sweep.jobs, retraining):
            expected = "settings under which no job was tested before they are stated"
            remedy = "give other seeds= or epochs=; a study by hand stays, and is not what its sweep compares"
        if expected:
            place = f"{directory.path}/sweep.json, terms.retraining"
            raise RunError(retraining.settings, place=place, expected=expected, remedy=remedy)
        directory.write(replace(sweep, terms=replace(sweep.terms, retraining=retraining)))


def _is_tested(directory: SweepDirectory, jobs: Sequence[Job], stated: Retraining) -> bool:
    """Return whether a job has a finished study as its sweep states them, of however many elites."""
    records = (study.read() for job in jobs for study in studies_of(directory.run(job).path))
    return any(record.digest is not None and is_stated(record, stated) for record in records)
