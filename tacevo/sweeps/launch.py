"""Run the jobs of a sweep: on this machine as processes, on a cluster by submitit.

Each job is the command that a user would type, `tacevo search ... run.dir=SWEEP/NAME`, in a process and a session of
its own. So a job that fails or is killed stops no other, and a terminal's Ctrl-C reaches the launching process only.

Promises: on this machine a job ends with the process that launched it, however that ends; asked to stop, all jobs end
as by Ctrl-C, and keep what they have.
What it does not: a job that a cluster has taken outlives a launching process that is killed.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from tacevo.errors import ConfigError, RunError
from tacevo.records import Json
from tacevo.sandbox.kernel import end_with
from tacevo.storage.sweep_directory import Job, SweepDirectory, seeded

if TYPE_CHECKING:
    import submitit

#: How the overrides of the launcher begin.
_LAUNCHER, _OPTION = "hydra/launcher=", "hydra.launcher."

#: Executors of submitit, by what `hydra/launcher=` calls them.
_CLUSTERS = {"submitit_slurm": "slurm", "submitit_local": "local"}

#: Parameters that all executors of submitit share; any other one belongs to its executor.
_SHARED = frozenset(
    {"name", "timeout_min", "mem_gb", "nodes", "cpus_per_task", "gpus_per_node", "tasks_per_node", "stderr_to_stdout"}
)

#: Seconds between two looks at the jobs, and those that a job has to stop.
_TICK, _GRACE = 0.5, 60.0

#: The exit status of a search that was told to stop.
_INTERRUPTED = 130

#: How the last line of a failed command begins.
_ERROR = "error: "


@dataclass(frozen=True, slots=True, kw_only=True)
class Launcher:
    """Where the jobs run, and how."""

    #: A key of `_CLUSTERS`; empty for this machine.
    cluster: str = ""
    #: By name, as `n_jobs`.
    options: Mapping[str, Json]


def split_launcher(overrides: Sequence[str]) -> tuple[Launcher, tuple[str, ...]]:
    """Separate the overrides of the launcher from the settings of the jobs.

    Raises:
        ConfigError: there are two launchers, or one that is not known.
    """
    launchers = [override.removeprefix(_LAUNCHER) for override in overrides if override.startswith(_LAUNCHER)]
    if launchers and (len(launchers) > 1 or launchers[0] not in _CLUSTERS):
        raise ConfigError(
            " and ".join(launchers),
            place="hydra/launcher",
            expected=f"one of {', '.join(_CLUSTERS)}",
            remedy="leave it out to run the jobs on this machine",
        )
    own = [override.removeprefix(_OPTION).partition("=") for override in overrides if override.startswith(_OPTION)]
    try:
        options = {name: yaml.safe_load(value) for name, _, value in own}
    except yaml.YAMLError as error:
        raise ConfigError(
            _in_short(error), place="hydra.launcher", expected="NAME=VALUE, with a value in YAML"
        ) from error
    rest = (override for override in overrides if not override.startswith((_LAUNCHER, _OPTION)))
    return Launcher(cluster=launchers[0] if launchers else "", options=options), tuple(rest)


def fitted(launcher: Launcher, *, jobs: int, workers: int, cores: int) -> Launcher:
    """Return the launcher with what the user left open: as many jobs at once as the cores can take, say.

    Jobs have up to so many workers; `cores` are those that this process may use.
    """
    sizes = {"cpus_per_task": workers, "timeout_min": 60}
    if not launcher.cluster:
        sizes = {"n_jobs": max(1, min(jobs, cores // workers))}
    return Launcher(cluster=launcher.cluster, options={**sizes, **launcher.options})


def check_launcher(launcher: Launcher) -> None:
    """Check a launcher before anything runs.

    Raises:
        ConfigError: it is not installed or not available here, or it does not have such an option.
    """
    if launcher.cluster:
        with tempfile.TemporaryDirectory() as directory:
            _executor(launcher, Path(directory))
        return
    for name, value in launcher.options.items():
        if name != "n_jobs" or type(value) is not int or value < 1:
            raise ConfigError(
                f"{name}={value}", place="hydra.launcher", expected="n_jobs=N, with N an integer of at least 1"
            )


def launch(directory: SweepDirectory, jobs: Sequence[Job], launcher: Launcher, show: Callable[[Job], None]) -> None:
    """Run jobs to their ends; the sweep's directory keeps how each ended.

    The launcher is checked and fitted. `show` gets each job that ends; if it raises, all others are stopped first.

    Raises:
        RunError: the cluster does not take the jobs.
        KeyboardInterrupt: the user stopped it; all jobs of this machine have ended.
    """
    directory.launch.mkdir(parents=True, exist_ok=True)
    if launcher.cluster:
        _launch_on_cluster(directory, jobs, launcher, show)
    else:
        _launch_here(directory, jobs, launcher, show)


def _launch_here(
    directory: SweepDirectory, jobs: Sequence[Job], launcher: Launcher, show: Callable[[Job], None]
) -> None:
    """Run jobs as processes, so many at once as the launcher says."""
    most = launcher.options["n_jobs"]
    assert isinstance(most, int)  # `check_launcher` refuses anything else
    waiting, running = list(jobs), dict[Job, subprocess.Popen[bytes]]()
    try:
        while waiting or running:
            while waiting and len(running) < most:
                job = waiting.pop(0)
                running[job] = _start(directory, job)
            time.sleep(_TICK)
            for job in [job for job, search in running.items() if search.poll() is not None]:
                _keep_ending(directory, job, running.pop(job).returncode)
                show(job)
    finally:
        _stop(running.values())


def _launch_on_cluster(
    directory: SweepDirectory, jobs: Sequence[Job], launcher: Launcher, show: Callable[[Job], None]
) -> None:
    """Submit jobs, and wait until the cluster is done with them."""
    executor = _executor(launcher, directory.launch / "submitit")
    try:
        tasks = executor.map_array(partial(run_job, directory.path), [job.name for job in jobs])
    except Exception as error:  # submitit's, the scheduler's or the file system's
        raise RunError(_in_short(error), place=launcher.cluster, expected="the cluster to take the jobs") from error
    running = dict(zip(jobs, tasks, strict=True))
    try:
        while running:
            time.sleep(_TICK)
            for job in [job for job, task in running.items() if task.done()]:
                failure = running.pop(job).exception()
                if failure is not None:
                    directory.fail(job, _in_short(failure))
                show(job)
    finally:
        for task in running.values():
            task.cancel(check=False)


def run_job(sweep: Path, name: str) -> None:
    """Run one job to its end; submitit calls this on a node."""
    directory = SweepDirectory(sweep)
    job = next(job for job in directory.read()[1] if job.name == name)
    _keep_ending(directory, job, _start(directory, job).wait())


def overrides_of(directory: SweepDirectory, job: Job) -> tuple[str, ...]:
    """Return the settings of a job: what all share, its own, and what follows from its seed."""
    return (*directory.read()[0], *job.overrides, *seeded(directory.read_terms().vary, job.seed))


def _executor(launcher: Launcher, directory: Path) -> "submitit.AutoExecutor":
    """Return the executor of a cluster, with its parameters."""
    cluster = _CLUSTERS[launcher.cluster]
    options = {key if key in _SHARED else f"{cluster}_{key}": value for key, value in launcher.options.items()}
    try:
        import submitit

        executor = submitit.AutoExecutor(directory, cluster=cluster)
        executor.update_parameters(**options)
    except Exception as error:  # submitit has a class of its own for each mistake
        raise ConfigError(
            _in_short(error),
            place=f"hydra/launcher={launcher.cluster}",
            expected="a launcher that is installed, and options that it has",
            remedy="install it by pip install 'tacevo[slurm]'" if isinstance(error, ImportError) else "",
        ) from error
    return executor


def _start(directory: SweepDirectory, job: Job) -> subprocess.Popen[bytes]:
    """Start the search of a job; it ends with this process."""
    place = str(directory.run(job).path).replace("'", "\\'")
    overrides = [*overrides_of(directory, job), f"run.dir='{place}'"]
    with directory.log(job).open("wb") as output:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "tacevo.cli.app", "search", *overrides],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=partial(end_with, os.getpid()),  # noqa: PLW1509  # takes no lock, and imports nothing
        )


def _stop(searches: Iterable[subprocess.Popen[bytes]]) -> None:
    """End searches as Ctrl-C does, or kill them if that takes too long."""
    for search in searches:
        search.terminate()
    deadline = time.monotonic() + _GRACE
    for search in searches:
        try:
            search.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            search.kill()
            search.wait()


def _keep_ending(directory: SweepDirectory, job: Job, status: int) -> None:
    """Keep how a search ended, by its exit status; one that was told to stop neither succeeded nor failed."""
    if status == 0:
        directory.succeed(job)
    elif status != _INTERRUPTED:
        directory.fail(job, _reason(status, directory.log(job)))


def _reason(status: int, log: Path) -> str:
    """Say why a search failed."""
    if status < 0:
        return f"killed by signal {-status} ({signal.strsignal(-status)}); memory may have run out"
    lines = [line for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    errors = [line for line in lines if line.startswith(_ERROR)] or lines
    return errors[-1].removeprefix(_ERROR) if errors else f"exit status {status}, without any output"


def _in_short(error: BaseException) -> str:
    lines = [line for line in str(error).splitlines() if line.strip()]
    return lines[0].strip() if lines else type(error).__name__
