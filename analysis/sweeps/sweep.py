"""A sweep as records: its finished runs by arm and seed, and what is missing of it."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from analysis.runs.run import Run, load_run
from tacevo.errors import RunError
from tacevo.records import Json
from tacevo.search.files import finished_digest
from tacevo.storage.sweep_directory import Job, SweepDirectory, name_arm

#: Hashes what decides the results of a run, from the configuration in its run.json (`tacevo.config.identity`). It is
#: handed in, for it needs Hydra's side of the house, which the analysis does not know.
HashOf = Callable[[Mapping[str, Json]], str]

#: The arm that all others are compared with: the search as it is.
REFERENCE = "none"


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """A finished job."""

    job: Job
    run: Run
    #: Of Python and packages, by name, as run.json has them.
    versions: Mapping[str, Json]


@dataclass(frozen=True, slots=True, kw_only=True)
class Missing:
    """A job without a result."""

    job: Job
    #: In words, e.g. `not begun`.
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """What there is of a sweep, in the order of its jobs."""

    path: Path
    #: At least one.
    finished: tuple[Finished, ...]
    missing: tuple[Missing, ...]

    @property
    def task(self) -> str:
        """The task's name."""
        return self.finished[0].run.task


def load_sweep(path: Path, hash_of: HashOf) -> Sweep:
    """Read the finished jobs of a sweep, and say of the others why they are missing.

    Args:
        path: the folder of the sweep.
        hash_of: gives what sweep.json has as `config` of a job.

    Raises:
        RunError: this is no sweep, none of its jobs is finished, an arm has a seed twice or another name than its
            overrides give, or a run was damaged or edited or is not that of its job.
    """
    directory = SweepDirectory(path)
    _, jobs = directory.read()
    _refuse_twins(path, jobs)
    _refuse_renamed(path, jobs)
    finished, missing = [], []
    for job in jobs:
        reason = _absence(directory, job)
        if reason is None:
            finished.append(_load(directory, job, hash_of))
        else:
            missing.append(Missing(job=job, reason=reason))
    if not finished:
        raise RunError(
            f"no job of {path} is finished, so there is nothing to compare; the `tacevo search -m` command that began "
            "the sweep goes on with it"
        )
    return Sweep(path=path, finished=tuple(finished), missing=tuple(missing))


def _absence(directory: SweepDirectory, job: Job) -> str | None:
    """Say why a job has no result; None where it has one."""
    run = directory.run(job)
    if finished_digest(run) is not None:
        return None
    failure = directory.failure(job)
    if failure is not None:
        return f"failed: {failure}"
    return "not finished" if (run.path / "run.json").exists() else "not begun"


def _load(directory: SweepDirectory, job: Job, hash_of: HashOf) -> Finished:
    folder = directory.run(job)
    run = load_run(folder.path)
    if run.config["seed"] != job.seed:
        raise RunError(
            f"{folder.path} holds a run of seed {run.config['seed']}, and sweep.json says {job.seed} of it; delete the "
            "folder, and the command that began the sweep repeats the job"
        )
    if hash_of(run.config) != job.config:
        raise RunError(
            f"{folder.path} holds the run of another configuration than sweep.json's job {job.name}, so it may be "
            "that of another arm; put the right folder there, or delete it, and the command that began the sweep "
            "repeats the job"
        )
    return Finished(job=job, run=run, versions=folder.read_run().versions)


def _refuse_twins(path: Path, jobs: tuple[Job, ...]) -> None:
    for (arm, seed), times in Counter((job.arm, job.seed) for job in jobs).items():
        if times > 1:
            raise RunError(
                f"{path}/sweep.json has {times} jobs of arm {arm} with seed {seed}; a seed is one run of an arm. Sweep "
                "what they differ in, so that each has an arm of its own"
            )


def _refuse_renamed(path: Path, jobs: tuple[Job, ...]) -> None:
    """Check that arms have the names of what they change; a published sweep has no overrides, and names are labels."""
    for job in jobs:
        if job.overrides and job.arm != name_arm(job.overrides):
            raise RunError(
                f"{path}/sweep.json calls the arm of job {job.name} {job.arm!r}, and its overrides make it "
                f"{name_arm(job.overrides)!r}; restore the file, or delete it, and the `tacevo search -m` command that "
                "began the sweep writes it again"
            )
