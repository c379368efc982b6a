"""Handing the jobs of a sweep to Hydra's multirun: on this machine by joblib, on a cluster by submitit.

What Hydra launches is a watchman for each job, which imports no more than Hydra itself and starts the job as the very
command that a user would type, `tacevo search ... run.dir=SWEEP/NAME`. So a job that is killed takes nobody with it,
no state of one reaches another, and what it says is in a file of its own.

The launcher itself is a process in a session of its own, so that a terminal's Ctrl-C reaches only the process that
launches it, and no watchman, which would end with a traceback and take its search along.

Promises: a job ends with its watchman, and on this machine with whoever launched it, however that ends; asked to stop,
all jobs end as by Ctrl-C, and keep what they have.
What it does not: a job that a cluster has taken outlives a launching process that is killed.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any

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
from tacevo.storage.sweep_directory import Job, SweepDirectory

#: What runs the jobs unless another launcher is asked for.
DEFAULT = "joblib"

#: Launchers whose jobs run on the machine that launches them.
_LOCAL = frozenset({"basic", "joblib", "submitit_local"})

#: Seconds between two looks at whether a job is still wanted, and those it has to stop.
_TICK, _GRACE = 1.0, 60.0

#: The exit status of a search that was told to stop.
_INTERRUPTED = 130

#: What the launcher's own log is called.
_LAUNCHER = "launcher"

#: How a line begins that says why a process came to nothing.
_ERROR = "error: "


@dataclass(kw_only=True)
class Assignment:
    """What Hydra's multirun composes for each job; a schema, which Hydra cannot merge into where it is frozen."""

    #: The sweep's folder.
    sweep: str = MISSING
    #: The job's name.
    job: str = MISSING
    #: Process whose end is the job's; 0 for none.
    caller: int = 0
    #: When it started, in clock ticks since the machine did: another process may have its number later.
    since: int = 0


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
        launcher: which runs them, found good (`require_launcher`).
        look: called every second or so; where it raises, all jobs are stopped first.

    Raises:
        RunError: the launcher failed.
        KeyboardInterrupt: the user stopped it; all jobs have ended.
    """
    directory.launch.mkdir(parents=True, exist_ok=True)
    directory.halt.unlink(missing_ok=True)
    with _heeding(directory.halt):
        status = _launched(directory, jobs, launcher, look)
    if directory.halt.exists():
        directory.halt.unlink()
        raise KeyboardInterrupt
    if status != 0:
        raise RunError(f"hydra/launcher={launcher.name} failed: {_reason(status, directory.log(_LAUNCHER))}")


def _launched(directory: SweepDirectory, jobs: Sequence[Job], launcher: Launcher, look: Callable[[], None]) -> int:
    """Run the launcher as a process, and look on until it ends; give its exit status."""
    caller = os.getpid() if launcher.name in _LOCAL else 0
    assignment = Assignment(sweep=str(directory.path), caller=caller, since=_start_of(caller) or 0)
    task = json.dumps([asdict(assignment), asdict(launcher), [job.name for job in jobs]])
    with directory.log(_LAUNCHER).open("wb") as output:
        launching = _start([sys.executable, "-P", "-c", f"from {__name__} import serve; serve()", task], output)
    try:
        while launching.poll() is None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                launching.wait(_TICK)
            look()
    finally:
        if launching.poll() is None:
            directory.halt.touch()
        launching.wait()
    return launching.returncode


def _start(command: Sequence[str], output: IO[bytes]) -> subprocess.Popen[bytes]:
    """Start a process that no terminal reaches and that ends with this one."""
    return subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        preexec_fn=partial(end_with, os.getpid()),  # noqa: PLW1509  # takes no lock, and imports nothing
    )


@contextlib.contextmanager
def _heeding(halt: Path) -> Iterator[None]:
    """Turn Ctrl-C and SIGTERM into a request to all jobs."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda number, frame: halt.touch()) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def serve() -> None:
    """Let Hydra run over the names of jobs; what `launch` starts, and gives its task as the only argument."""
    assignment, launcher, names = json.loads(sys.argv[1])
    try:
        with _initialised(Assignment(**assignment)) as hydra:
            overrides = _overrides(Launcher(**launcher), [f"job={','.join(names)}"])
            hydra.multirun("assignment", watch, overrides, with_log_configuration=False)
    except Exception as error:  # of a launcher, which is not ours
        sys.exit(f"{_ERROR}{_in_short(error)}")


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


def watch(assignment: Any) -> None:
    """Run one job as a process, and write down how it ended; Hydra calls this, in a process of the launcher's.

    Args:
        assignment: a `DictConfig` of `Assignment`.
    """
    directory = SweepDirectory(Path(assignment.sweep))
    wanted = partial(_is_wanted, directory.halt, assignment.caller, assignment.since)
    if wanted():
        shared, jobs = directory.read()
        job = next(job for job in jobs if job.name == assignment.job)
        _run(directory, job, [*shared, *job.overrides], wanted)
    if not _is_alive(assignment.caller, assignment.since):
        os._exit(_INTERRUPTED)  # nobody takes the answer, and joblib's processes would wait minutes for more


def _run(directory: SweepDirectory, job: Job, overrides: Sequence[str], wanted: Callable[[], bool]) -> None:
    """Run a search until it ends or is no longer wanted."""
    place = str(directory.run(job).path).replace("'", "\\'")
    command = [sys.executable, "-P", "-m", "tacevo.cli.app", "search", *overrides, f"run.dir='{place}'"]
    log = directory.log(job.name)
    with log.open("wb") as output:
        search = _start(command, output)
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
    told = [line for line in lines if line.startswith(_ERROR)] or lines
    return told[-1].removeprefix(_ERROR) if told else f"it ended with status {status} and said nothing"


def _is_wanted(halt: Path, caller: int, since: int) -> bool:
    return not halt.exists() and _is_alive(caller, since)


def _is_alive(caller: int, since: int) -> bool:
    """Tell whether the process that started then lives; one that nobody names, 0, does."""
    return caller == 0 or _start_of(caller) == since


def _start_of(pid: int) -> int | None:
    """Read when a process started, in clock ticks since the machine did; None where it has ended, reaped or not."""
    try:
        state, *fields = Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()
    except (OSError, ValueError):  # it is gone, or was going
        return None
    return None if state in {"Z", "X"} else int(fields[18])  # the 22nd field of all


def _in_short(error: BaseException) -> str:
    lines = [line for line in str(error).splitlines() if line.strip()]
    return lines[0].strip() if lines else type(error).__name__
