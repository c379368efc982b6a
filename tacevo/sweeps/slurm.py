"""The jobs of a sweep on Slurm, by submitit; imported only where Slurm was chosen, because it is an extra.

Promises: a job that is requeued continues where it stopped; asked to stop, all jobs are cancelled, queued and running;
a job is waited for until Slurm itself has done with it, with or without Slurm's accounting; no password or key of this
process enters what is submitted.
What it does not: a job outlives a launching process that is killed.
"""

import contextlib
import os
import subprocess
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path

import submitit
from submitit.core.utils import UncompletedJobError
from submitit.helpers import Checkpointable

from tacevo.errors import RunError
from tacevo.records import Json
from tacevo.redaction import secret_variables
from tacevo.results.sweep import Standing
from tacevo.storage.sweep_directory import Job, SweepDirectory
from tacevo.sweeps.search_process import GRACE, keep_ending, start, stop
from tacevo.sweeps.status import status_of
from tacevo.text import first_line

#: Parameters that all executors of submitit share; any other one belongs to its executor.
_SHARED = frozenset(
    {"name", "timeout_min", "mem_gb", "nodes", "cpus_per_task", "gpus_per_node", "tasks_per_node", "stderr_to_stdout"}
)

#: The number of times that a job is queued again whose time is out; a parameter of the executor itself.
_RESUMED = "max_num_timeout"

#: Every job of this user that Slurm still remembers, each of an array on a line of its own.
_QUEUE = ["squeue", "--me", "--all", "--noheader", "--array", "--states=all", "--format=%i %T"]

#: States that a job does not leave.
_OVER = frozenset(
    {
        "BOOT_FAIL",
        "CANCELLED",
        "COMPLETED",
        "DEADLINE",
        "FAILED",
        "NODE_FAIL",
        "OUT_OF_MEMORY",
        "PREEMPTED",
        "REVOKED",
        "TIMEOUT",
    }
)

#: Seconds between two looks at the jobs: one controller answers all users.
_TICK = 5.0

_Task = submitit.Job[None]


#: Keeps the directory that Python is started in off the import path.
_SAFE_PATH = "PYTHONSAFEPATH"


class SearchJob(Checkpointable):
    """Runs the search of a job on a node; after a requeue again, because the same command continues."""

    def __call__(self, sweep: Path, name: str) -> None:
        """Run it to its end, or until the scheduler wants the node back."""
        directory = SweepDirectory(sweep)
        job = next(job for job in directory.read().jobs if job.name == name)
        search = start(directory, job)
        try:
            keep_ending(directory, job, search.wait())
        except UncompletedJobError:  # out of submitit's signal handler
            reason = "out of time (hydra.launcher.timeout_min); the same command resumes it"
            directory.fail(job, reason, by_scheduler=True)
        finally:
            stop([search])


def executor_of(options: Mapping[str, Json], directory: Path) -> submitit.AutoExecutor:
    """Return submitit's executor, with its parameters.

    Raises:
        Exception: of a class of submitit's for each mistake.
    """
    resumed = options.get(_RESUMED, 0)
    if type(resumed) is not int or resumed < 0:
        raise ValueError(f"{_RESUMED}={resumed} is not an integer of at least 0")
    own = {key if key in _SHARED else f"slurm_{key}": value for key, value in options.items() if key != _RESUMED}
    executor = submitit.AutoExecutor(directory, cluster="slurm", slurm_max_num_timeout=resumed)
    executor.update_parameters(**own)
    return executor


def launch_on_slurm(
    directory: SweepDirectory, jobs: Sequence[Job], options: Mapping[str, Json], show: Callable[[Job], None]
) -> None:
    """Submit jobs, and wait until Slurm is done with them; as `tacevo.sweeps.launch.launch`."""
    executor = executor_of(options, directory.launch / "submitit")
    search = SearchJob()  # type: ignore[no-untyped-call]  # submitit's
    tasks: list[_Task] = []
    try:
        with _submitting():
            tasks += executor.map_array(search, [directory.path] * len(jobs), [job.name for job in jobs])
        of_task = {task.job_id: job for job, task in zip(jobs, tasks, strict=True)}
        while tasks:
            time.sleep(_TICK)
            over = _ended(tasks)
            tasks = [task for task in tasks if task.job_id not in over]
            for number, reason in over.items():
                job = of_task[number]
                if reason and status_of(directory, job).standing not in {Standing.finished, Standing.running}:
                    directory.fail(job, reason, by_scheduler=True)
                show(job)
    finally:
        _cancel(tasks)


def _cancel(tasks: Sequence[_Task]) -> None:
    """Cancel jobs, and wait until they have stopped, so that the same command, given next, finds none running."""
    for task in tasks:
        task.cancel(check=False)
    deadline = time.monotonic() + GRACE
    while len(_ended(tasks)) < len(tasks) and time.monotonic() < deadline:
        time.sleep(_TICK)


def _ended(tasks: Collection[_Task]) -> dict[str, str]:
    """Return the jobs that have ended, by their ids, each with what went wrong outside its search.

    Slurm is asked, for a result may be there, and the job in the queue again.
    """
    queue = subprocess.run(_QUEUE, capture_output=True, text=True, check=False)
    if queue.returncode != 0:  # the controller does not answer, which jobs survive
        return {}
    states = dict(line.split() for line in queue.stdout.splitlines())
    over = ((task, states.get(task.job_id, "forgotten")) for task in tasks)
    return {
        task.job_id: "" if state == "COMPLETED" else f"Slurm: {state}{_last_line(task.paths.stderr)}"
        for task, state in over
        if state in _OVER or task.job_id not in states
    }


def _last_line(log: Path) -> str:
    """Return what a job said last, in parentheses; srun repeats how it ended."""
    text = log.read_text(encoding="utf-8", errors="replace") if log.exists() else ""
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith("srun: ")]
    return f" ({lines[-1]})" if lines else ""


@contextlib.contextmanager
def _submitting() -> Iterator[None]:
    """Hide passwords and keys: a scheduler keeps the environment of who submits a job on the controller's disk.

    A job starts as `python -m`, which would import a file such as random.py from where it was submitted.

    Raises:
        RunError: the cluster did not take the jobs.
    """
    hidden = {name: os.environ.pop(name) for name in secret_variables(os.environ)}
    unset = _SAFE_PATH not in os.environ
    os.environ.setdefault(_SAFE_PATH, "1")
    try:
        yield
    except Exception as error:  # submitit's, the scheduler's or the file system's
        raise RunError(first_line(error), place="submitit_slurm", expected="the cluster to take the jobs") from error
    finally:
        os.environ.update(hidden)
        if unset:
            del os.environ[_SAFE_PATH]
