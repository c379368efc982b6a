"""`tacevo study sweep=DIR`: the best networks of every job of a sweep, trained fully with fresh seeds and tested.

Each job gets an ordinary study, of the baseline and its best elites, or of the one that a choice hands over, in its own
directory. What is stated once for all
of them, how many elites, seeds, epochs and what `best` means, is written into sweep.json before the first training, so
that `tacevo ablations` knows which studies count, whatever other studies the runs have.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from tacevo.config.sources import is_of_data
from tacevo.config.study import StudyConfig
from tacevo.errors import ConfigError, RunError
from tacevo.evolution.run_files import finished_digest
from tacevo.results.publishable import other_device
from tacevo.results.settings import settings_of
from tacevo.results.study_directory import is_stated, studies_of
from tacevo.results.sweep import REFERENCE
from tacevo.runs.progress import Progress
from tacevo.runs.session import mirrored_together
from tacevo.storage.sweep_directory import Job, Retraining, SweepDirectory, SweepRecord, naming
from tacevo.studies.study import MirrorLater, Studied, check_study, study
from tacevo.text import counted, listed
from tacevo.typed import FreeJson


def study_sweep(
    path: Path, config: StudyConfig, view: Progress, other: Sequence[str] = ()
) -> tuple[list[Studied], list[str]]:
    """Study the best elites of each finished job of a sweep in a directory, or resume such studies.

    Returns:
        The studies of the finished jobs, in the order of these, at least one; and the names of the unfinished jobs;
        both of the arms that are studied.

    Raises:
        ConfigError: the sweep does not have the arms that are to be studied, or its reference is not among them; or
            settings of data are given among the `other` ones.
        TacevoError: see its subclasses, with the job named; the trainings that ended are kept.
        KeyboardInterrupt: the user stopped it; the same command continues.
    """
    if data := [setting for setting in other if is_of_data(setting)]:
        expected = "no setting of data with sweep=: jobs are compared on their own data"
        raise ConfigError(data[0], place="study", expected=expected)
    directory = SweepDirectory(path)
    sweep = directory.read()
    arms = _arms(sweep, config.arms)
    finished = finished_jobs(directory, [job for job in sweep.jobs if not arms or job.arm in arms])
    retraining = Retraining(
        elites=config.elites,
        seeds=config.seeds,
        epochs=config.epochs,
        choose=config.choose,
        arms=arms,
        other_device=_other_device(directory, finished, config, other),
    )

    def of_job(run: str) -> StudyConfig:
        return replace(config, run=run, sweep=None, arms=())

    for job in finished:
        with naming(job.name):  # what is refused is not said to be tested
            check_study(of_job(str(directory.run(job).path)), other)
    if sweep.terms.retraining != retraining:
        _state(directory, retraining)

    def train(run: str, later: MirrorLater) -> Studied:
        studied = study(of_job(run), view, other, later)
        if (lacking := retraining.tested + 1 - studied.trainings // config.seeds) > 0:
            places = f"{lacking} of {counted(retraining.tested, 'place')}"
            view.say(f"no elite for {places}: the baseline counts there, so each job's score is of as many networks")
        return studied

    studies, unfinished = each_job(directory, finished, train, view)
    return studies, [job.name for job in unfinished if retraining.tests(job.arm)]


def _other_device(
    directory: SweepDirectory, jobs: Sequence[Job], config: StudyConfig, other: Sequence[str]
) -> tuple[tuple[str, FreeJson], ...]:
    """Return in which settings of numerics and device the studies of all jobs are not the jobs' own."""
    if not other:
        return ()
    from tacevo.config.compose import compose_elsewhere  # imports Hydra, which most sweeps' studies do not need

    own = [replace(settings_of(directory.run(job)), executor=config.executor) for job in jobs]
    differing = [other_device(one, compose_elsewhere(one, other)) for one in own]
    for job, one in zip(jobs, differing, strict=True):
        if one != differing[0]:
            expected = f"jobs that all differ in {dict(differing[0])} from it, as {jobs[0].name} does"
            raise ConfigError(f"{dict(one)} of {job.name}", place=", ".join(other), expected=expected)
    return differing[0]


def _arms(sweep: SweepRecord, named: Sequence[str]) -> tuple[str, ...]:
    """Return the arms whose jobs are to be studied, in the order of the sweep; () for all."""
    known = [*dict.fromkeys(job.arm for job in sweep.jobs)]
    reference = sweep.terms.reference or REFERENCE
    for arm in named:
        if arm not in known:
            raise ConfigError(repr(arm), place="arms", expected=f"arms of the sweep: {listed(known)}")
    if named and reference in known and reference not in named:
        raise ConfigError(
            listed(named), place="arms", expected=f"{reference} among them, which others are compared with"
        )
    return tuple(arm for arm in known if arm in named)


def finished_jobs(directory: SweepDirectory, jobs: Sequence[Job]) -> list[Job]:
    """Return the finished jobs of a sweep, at least one."""
    finished = [job for job in jobs if finished_digest(directory.run(job)) is not None]
    if not finished:
        got, expected = f"{len(jobs)} of {len(jobs)} that are not finished", "at least one finished job"
        raise RunError(got, place=str(directory.path), expected=expected, remedy="continue the sweep")
    return finished


def each_job(
    directory: SweepDirectory, finished: Sequence[Job], train: Callable[[str, MirrorLater], Studied], view: Progress
) -> tuple[list[Studied], list[Job]]:
    """Do the same for the run of each job, one after another; an error names the job; also return the other jobs.

    MLflow, which takes seconds for each run, is waited for once, when all is trained.
    """
    studies = []
    with mirrored_together(view) as later:
        for number, job in enumerate(finished, start=1):
            view.say(f"job {job.name} ({number} of {len(finished)})")
            with naming(job.name):
                studied = train(str(directory.run(job).path), later)
            studies.append(studied)
            view.advance("jobs", number, len(finished), recalled=studied.recorded == studied.trainings)
    jobs = directory.read().jobs  # with those that were added meanwhile
    return studies, [job for job in jobs if job not in finished]


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
