"""Handing the jobs of a sweep to Hydra's multirun: on this machine by joblib, on a cluster by submitit.

What Hydra launches is a watchman for each job, which imports no more than Hydra itself and starts the job as the very
command that a user would type, `tacevo search ... run.dir=SWEEP/NAME`. So a job that is killed takes nobody with it,
no state of one reaches another, and what it says is in a file of its own.

Promises: a job ends with its watchman, and on this machine with whoever launched it, however that ends; asked to stop,
all jobs end as by Ctrl-C, and keep what they have.
What it does not: a job that a cluster has taken outlives a launching process that is killed.
"""

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from hydra import initialize
from hydra._internal.hydra import Hydra
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import MISSING
from omegaconf.errors import OmegaConfBaseException

from tacevo.errors import ConfigError, RunError
from tacevo.sandbox.kernel import end_with
from tacevo.sweepdir import Job, SweepDirectory

#: What runs the jobs unless another launcher is asked for.
DEFAULT = "joblib"

#: Launchers whose jobs run on the machine that launches them.
_LOCAL = frozenset({"basic", "joblib", "submitit_local"})

#: Seconds between two looks at whether a job is still wanted, and those it has to stop.
_TICK, _GRACE = 1.0, 60.0

#: The exit status of a search that was told to stop.
_INTERRUPTED = 130


@dataclass(kw_only=True)
class Assignment:
    """What Hydra's multirun composes for each job; a schema, which Hydra cannot merge into where it is frozen."""

    #: The sweep's folder.
    sweep: str = MISSING
    #: The job's name.
    job: str = MISSING
    #: Process whose end is the job's; 0 for none.
    caller: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Launcher:
    """Which of Hydra's launchers runs the jobs, and how."""

    name: str
    #: Settings of it, as the user wrote them.
    overrides: tuple[str, ...]

    def sets(self, key: str) -> bool:
        """Tell whether the user set something of it."""
        return any(override.startswith(f"hydra.launcher.{key}=") for override in self.overrides)


def split_launcher(overrides: Sequence[str]) -> tuple[Launcher, tuple[str, ...]]:
    """Part what the user says of the launcher from the settings of the jobs.

    Raises:
        ConfigError: two launchers are named.
    """
    named = [override.partition("=")[2] for override in overrides if override.startswith("hydra/launcher=")]
    if len(named) > 1:
        raise ConfigError(f"a sweep has one launcher; got {' and '.join(named)}")
    own = tuple(override for override in overrides if override.startswith("hydra.launcher."))
    rest = (override for override in overrides if not override.startswith(("hydra/launcher=", "hydra.launcher.")))
    return Launcher(name=named[0] if named else DEFAULT, overrides=own), tuple(rest)


def fitted(launcher: Launcher, *, jobs: int, workers: int, cores: int) -> Launcher:
    """Let as many jobs run at once as the cores can take, unless the user said how many.

    Args:
        launcher: as the user asked for it.
        jobs: how many there are, at least 1.
        workers: `executor.workers`, the most of any job.
        cores: of this machine, those that this process may use.
    """
    sizes = {
        "joblib": f"n_jobs={max(1, min(jobs, cores // workers))}",
        "submitit_slurm": f"cpus_per_task={workers}",
    }
    size = sizes.get(launcher.name)
    if size is None or launcher.sets(size.partition("=")[0]):
        return launcher
    return Launcher(name=launcher.name, overrides=(*launcher.overrides, f"hydra.launcher.{size}"))


def require_launcher(launcher: Launcher) -> None:
    """Tell what is wrong with a launcher before anything runs.

    Raises:
        ConfigError: it is not installed, or has no such setting.
    """
    try:
        with _initialised(Assignment(sweep=".", job="any")) as hydra:
            hydra.compose_config("assignment", _overrides(launcher, []), RunMode.MULTIRUN)
    except (HydraException, OmegaConfBaseException) as error:
        remedy = "; pip install 'tacevo[slurm]' brings it" if launcher.name.startswith("submitit") else ""
        cause = _in_short(error.__cause__ or error).rstrip(".")
        raise ConfigError(f"hydra/launcher={launcher.name} cannot be used: {cause}{remedy}") from error


def launch(directory: SweepDirectory, jobs: Sequence[Job], launcher: Launcher, look: Callable[[], None]) -> None:
    """Run jobs to their ends; how each ended stands in the sweep's folder.

    Args:
        directory: the sweep's, with its sweep.json.
        jobs: at least one.
        launcher: which runs them.
        look: called every second or so, by a thread of its own.

    Raises:
        ConfigError: the launcher is not installed, or has no such setting.
        RunError: the launcher failed.
        KeyboardInterrupt: the user stopped it; all jobs have ended.
    """
    directory.launch.mkdir(parents=True, exist_ok=True)
    directory.halt.unlink(missing_ok=True)
    with _stopping(directory, look):
        try:
            _multirun(directory, jobs, launcher)
        except Exception as error:  # of a launcher, which is not ours
            if not directory.halt.exists():
                raise RunError(f"hydra/launcher={launcher.name} failed: {_in_short(error)}") from error
    if directory.halt.exists():
        directory.halt.unlink()
        raise KeyboardInterrupt


def _multirun(directory: SweepDirectory, jobs: Sequence[Job], launcher: Launcher) -> None:
    """Let Hydra run over the names of the jobs."""
    caller = os.getpid() if launcher.name in _LOCAL else 0
    with _initialised(Assignment(sweep=str(directory.path), caller=caller)) as hydra:
        overrides = _overrides(launcher, [f"job={','.join(job.name for job in jobs)}"])
        hydra.multirun("assignment", watch, overrides, with_log_configuration=False)


@contextlib.contextmanager
def _initialised(assignment: Assignment) -> Iterator[Hydra]:
    """Give Hydra with nothing to compose but an assignment."""
    ConfigStore.instance().store(name="assignment", node=assignment)
    GlobalHydra.instance().clear()
    with initialize(config_path=None, version_base="1.3", job_name="tacevo"):
        hydra = GlobalHydra.instance().hydra
        if hydra is None:
            raise RunError("Hydra has just been initialised, and says that it is not; install hydra-core again")
        yield hydra


def _overrides(launcher: Launcher, more: Sequence[str]) -> list[str]:
    """Write what Hydra is told: who launches, and that nothing of it goes into the run directories."""
    return [
        f"hydra/launcher={launcher.name}",
        *launcher.overrides,
        "hydra.sweep.dir=${sweep}/launch",
        "hydra.sweep.subdir=.",
        "hydra.output_subdir=null",
        "hydra/hydra_logging=none",
        "hydra/job_logging=none",
        *more,
    ]


@contextlib.contextmanager
def _stopping(directory: SweepDirectory, look: Callable[[], None]) -> Iterator[None]:
    """Turn Ctrl-C and SIGTERM into a request to all jobs, and have somebody look on meanwhile.

    SIGINT is blocked rather than handled: that is inherited, so that a terminal's Ctrl-C reaches no process of a
    launcher, which would end with a traceback.
    """
    over = threading.Event()

    def follow() -> None:
        while not over.is_set():
            if signal.sigtimedwait({signal.SIGINT}, _TICK) is not None:
                directory.halt.touch()
            look()

    thread = threading.Thread(target=follow, name="look")
    before = signal.signal(signal.SIGTERM, lambda number, frame: directory.halt.touch())
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        signal.signal(signal.SIGTERM, before)


def watch(assignment: Any) -> None:
    """Run one job as a process, and write down how it ended; Hydra calls this, in a process of the launcher's.

    Args:
        assignment: a `DictConfig` of `Assignment`.
    """
    directory = SweepDirectory(Path(assignment.sweep))
    wanted = partial(_is_wanted, directory.halt, assignment.caller)
    if wanted():
        shared, jobs = directory.read()
        job = next(job for job in jobs if job.name == assignment.job)
        _run(directory, job, [*shared, *job.overrides], wanted)
    if not _is_alive(assignment.caller):
        os._exit(_INTERRUPTED)  # nobody takes the answer, and joblib's processes would wait minutes for more


def _run(directory: SweepDirectory, job: Job, overrides: Sequence[str], wanted: Callable[[], bool]) -> None:
    """Run a search until it ends or is no longer wanted."""
    place = str(directory.run(job).path).replace("'", "\\'")
    command = [sys.executable, "-P", "-m", "tacevo.app", "search", *overrides, f"run.dir='{place}'"]
    log = directory.log(job.name)
    with log.open("wb") as output:
        search = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=partial(end_with, os.getpid()),  # noqa: PLW1509  # takes no lock, and imports nothing
        )
        status = _attend(search, wanted)
    if status == 0:
        directory.succeed(job)
    elif status != _INTERRUPTED:
        directory.fail(job, _reason(status, log))


def _attend(search: subprocess.Popen[bytes], wanted: Callable[[], bool]) -> int:
    """Wait for a search's end, or stop it when it is no longer wanted; give its exit status."""
    while wanted():
        with contextlib.suppress(subprocess.TimeoutExpired):
            return search.wait(_TICK)
    search.terminate()
    try:
        search.wait(_GRACE)
    except subprocess.TimeoutExpired:
        search.kill()
        search.wait()
    return _INTERRUPTED


def _reason(status: int, log: Path) -> str:
    """Say why a search came to nothing."""
    if status < 0:
        return f"killed by {signal.Signals(-status).name}; memory may have run out"
    lines = [line for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    return lines[-1].removeprefix("error: ") if lines else f"it ended with status {status} and said nothing"


def _is_wanted(halt: Path, caller: int) -> bool:
    return not halt.exists() and _is_alive(caller)


def _is_alive(caller: int) -> bool:
    """Tell whether a process lives; one that nobody names, 0, does."""
    try:
        os.kill(caller, 0) if caller else None
    except ProcessLookupError:
        return False
    return True


def _in_short(error: BaseException) -> str:
    lines = [line for line in str(error).splitlines() if line.strip()]
    return lines[0].strip() if lines else type(error).__name__
