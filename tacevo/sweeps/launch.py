"""Run the jobs of a sweep: on this machine as processes (`searches`), on Slurm by submitit (`slurm`).

Promises: on this machine a job ends with the process that launched it, however that ends; asked to stop, all jobs end
as by Ctrl-C, and keep what they have. What it does not: our code is imported once for all jobs, so one that begins
after the code was changed names the new commit, and runs the old one.
"""

import math
import re
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from tacevo.config.schema import RunConfig
from tacevo.config.strict_yaml import read_yaml
from tacevo.errors import ConfigError
from tacevo.parts.registry import missing
from tacevo.records import Json
from tacevo.redaction import is_secret_variable
from tacevo.storage.sweep_directory import Job, SweepDirectory
from tacevo.sweeps.search_process import Starter, end, keep_ending, keep_order
from tacevo.text import first_line

#: The launcher that `hydra/launcher=` may name.
SLURM = "submitit_slurm"

#: Hydra's names for launchers of this machine, which its users type.
_HERE = ("basic", "joblib")

#: The remedy: what takes their place.
_INSTEAD = (
    "-m itself runs jobs as processes of this machine, as many at once as its cores take; hydra.launcher.n_jobs=N sets "
    "another number"
)

#: The beginnings of the launcher's overrides.
_LAUNCHER, _OPTION = "hydra/launcher=", "hydra.launcher."

#: The part of a core that a search takes whose candidates are computed elsewhere.
_DRIVER = 0.25

#: Seconds between two looks at the jobs.
_TICK = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Launcher:
    """The launcher of a sweep: where its jobs run, and how."""

    #: `SLURM`; empty for this machine.
    cluster: str = ""
    #: The options of the launcher by name, as `n_jobs`.
    options: Mapping[str, Json]
    #: The message to a user about the launcher that was named; empty where it is as Hydra has it.
    remark: str = ""


def split_launcher(overrides: Sequence[str]) -> tuple[Launcher, tuple[str, ...]]:
    """Separate the overrides of the launcher from the settings of the jobs.

    Raises:
        ConfigError: there are two launchers, or one that is not known.
    """
    launchers = [override.removeprefix(_LAUNCHER) for override in overrides if override.startswith(_LAUNCHER)]
    if launchers not in ([], [SLURM], *([name] for name in _HERE)):
        raise ConfigError(
            " and ".join(launchers),
            place="hydra/launcher",
            expected=" or ".join([SLURM, *_HERE]),
            remedy="leave it out for this machine",
        )
    own = [override.removeprefix(_OPTION).partition("=") for override in overrides if override.startswith(_OPTION)]
    try:
        options = {name: read_yaml(value) for name, _, value in own}
    except yaml.YAMLError as error:
        raise ConfigError(
            str(error).splitlines()[0], place="hydra.launcher", expected="NAME=VALUE, with a value in YAML"
        ) from error
    rest = (override for override in overrides if not override.startswith((_LAUNCHER, _OPTION)))
    cluster = SLURM if launchers == [SLURM] else ""
    remark = "" if cluster or not launchers else f"hydra/launcher={launchers[0]}: {_INSTEAD}"
    return Launcher(cluster=cluster, options=options, remark=remark), tuple(rest)


def needed_cores(config: RunConfig) -> float:
    """Return how many cores a job needs where it runs: hardly one where its candidates run on a given Ray cluster."""
    executor = config.executor
    if config.data.facts.is_looked_up:  # nothing is trained
        return 1
    return _DRIVER if not executor.is_here and executor.address else executor.workers


def fitted(launcher: Launcher, *, jobs: int, needed: float, cores: int) -> Launcher:
    """Return the launcher with what the user left open: as many jobs at once as the cores can take, say.

    Jobs need up to so many cores each; `cores` are those that this process may use.
    """
    sizes = {"cpus_per_task": math.ceil(needed), "timeout_min": 60}
    if not launcher.cluster:
        sizes = {"n_jobs": max(1, min(jobs, int(cores / needed)))}
    return Launcher(cluster=launcher.cluster, options={**sizes, **launcher.options})


def check_launcher(launcher: Launcher) -> None:
    """Check a launcher before anything runs.

    Raises:
        ConfigError: it is not installed or not available here, does not have such an option, or one holds a key.
    """
    if launcher.cluster:
        _check_cluster(launcher)
        return
    for name, value in launcher.options.items():
        if name != "n_jobs" or type(value) is not int or value < 1:
            raise ConfigError(
                f"{name}={value}", place="hydra.launcher", expected="n_jobs=N, with N an integer of at least 1"
            )


def launch(
    directory: SweepDirectory, jobs: Mapping[Job, RunConfig], launcher: Launcher, show: Callable[[Job], None]
) -> None:
    """Run jobs, each with its configuration, to their ends; the sweep's directory keeps how each ended.

    The launcher is checked and fitted. `show` gets each job that ends; if it raises, all others are stopped first.

    Raises:
        RunError: the cluster does not take the jobs.
        KeyboardInterrupt: the user stopped it; all jobs of this machine have ended, those of a cluster are cancelled.
    """
    directory.launch.mkdir(parents=True, exist_ok=True)
    if launcher.cluster:
        from tacevo.sweeps.slurm import launch_on_slurm

        for job, config in jobs.items():
            keep_order(directory, job, config)
        launch_on_slurm(directory, [*jobs], launcher.options, show)
    else:
        _launch_here(directory, jobs, launcher, show)


def _launch_here(
    directory: SweepDirectory, jobs: Mapping[Job, RunConfig], launcher: Launcher, show: Callable[[Job], None]
) -> None:
    """Run jobs as processes, so many at once as the launcher says."""
    most = launcher.options["n_jobs"]
    assert isinstance(most, int)  # `check_launcher` refuses anything else
    waiting, running, starters = list(jobs), dict[Job, Starter](), list[Starter]()
    try:
        while waiting or running:
            while waiting and len(running) < most:
                starter = next((each for each in starters if each not in running.values() and each.is_alive), None)
                if starter is None:
                    starters.append(starter := Starter(directory))
                job = waiting.pop(0)
                starter.start(job, jobs[job])
                running[job] = starter
            time.sleep(_TICK)
            statuses = {job: starter.poll() for job, starter in running.items()}
            for job, status in statuses.items():
                if status is not None:
                    del running[job]
                    keep_ending(directory, job, status)
                    show(job)
    finally:
        end(starters)


def _check_cluster(launcher: Launcher) -> None:
    """Check a launcher of submitit as `check_launcher` does."""
    place = f"hydra/launcher={launcher.cluster}"
    keys = [name for name in re.findall(r"(\w+)\s*=", str(launcher.options)) if is_secret_variable(name)]
    if keys:
        raise ConfigError(
            f"{keys[0]}=...",
            place=place,
            expected="options without a key, because they become the job's script",
            remedy="set it in a file that only you can read, and name that: 'hydra.launcher.setup=[\". FILE\"]'",
        )
    try:
        from tacevo.sweeps.slurm import executor_of

        with tempfile.TemporaryDirectory() as directory:
            executor_of(launcher.options, Path(directory))
    except Exception as error:  # submitit has a class of its own for each mistake
        raise ConfigError(
            first_line(error),
            place=place,
            expected="a launcher that is installed, and options that it has",
            remedy=missing(error).remedy if isinstance(error, ImportError) else "",
        ) from error
