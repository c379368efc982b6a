"""The environment of a run: commit, package versions, machine and commands. For people; no result depends on it."""

import contextlib
import os
import platform
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from tacevo.errors import TacevoError
from tacevo.records import Json, Record

#: Packages whose version may change a result or a number's meaning.
PACKAGES = (
    "tacevo",
    "torch",
    "numpy",
    "scipy",
    "scikit-learn",
    "pillow",
    "hydra-core",
    "omegaconf",
    "anthropic",
    "mlflow",
)

_ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True, slots=True, kw_only=True)
class Code(Record):
    """A checkout of this project."""

    #: 40 hex digits.
    commit: str
    #: Whether a file was changed since.
    dirty: bool


def checked_out(root: Path = _ROOT) -> Code | None:
    """Describe a checkout by its top directory; None where it is not that of a Git checkout, or Git fails."""
    if not (root / ".git").exists():
        return None
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}  # e.g. of a hook
    try:
        said = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return None
    commit, dirty, _ = said.strip().partition("-dirty")
    return Code(commit=commit, dirty=bool(dirty))


def versions(*more: str) -> dict[str, str]:
    """List the versions of Python, of the packages that matter and of `more`; `absent` where one is not installed."""
    known = {"python": platform.python_version()}
    for package in (*PACKAGES, *more):
        try:
            known[package] = _own() if package == "tacevo" else version(package)
        except PackageNotFoundError:
            known[package] = "absent"
    return known


def _own() -> str:
    """Return the version of this code: an installation of a checkout says which one it had when it was installed."""
    return str(vars(sys.modules["tacevo"])["__version__"])  # loaded with this module; importing it here points up


def deviations(recorded: Mapping[str, Json], here: Mapping[str, Json]) -> tuple[str, ...]:
    """Describe the facts of a run's environment that differ here, one line each.

    A package that is absent is none of them: it computed nothing, and what needs it says so.
    """
    return tuple(
        f"{name} is {here.get(name)}; the run had {was}"
        for name, was in recorded.items()
        if here.get(name) not in (was, "absent")
    )


@contextlib.contextmanager
def doubting(recorded: Mapping[str, Json]) -> Iterator[None]:
    """Name the recorded versions that are others here beside a failure of what reads or replays a run."""
    try:
        yield
    except TacevoError as error:
        others = deviations(recorded, versions())
        if others and "another version may be the reason" not in error.remedy:
            doubt = f"another version may be the reason: {', '.join(others)}"
            error.remedy = f"{error.remedy}; {doubt}" if error.remedy else doubt
        raise


def machine() -> dict[str, Json]:
    """Describe this machine's hardware and system, without its name."""
    info = Path("/proc/cpuinfo")
    text = info.read_text(encoding="utf-8") if info.exists() else ""
    models = [line.partition(":")[2].strip() for line in text.splitlines() if line.startswith("model name")]
    return {
        "cpu": models[0] if models else platform.processor(),
        "cores": os.cpu_count(),
        "architecture": platform.machine(),
        "system": f"{platform.system()} {platform.release()}",
        "libc": " ".join(platform.libc_ver()),
        "gpu": next(iter(gpus()), None),
    }


def install(extra: str) -> str:
    """Say how the packages of an extra are installed, as long as tacevo is not on an index."""
    return f"in the clone of tacevo: pip install -e '.[{extra}]'"


def usable_cores() -> int:
    """Return how many cores this process may use; the machine may have more."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def gpus(drivers: Path = Path("/proc/driver/nvidia/gpus")) -> list[str]:
    """Return the models of the NVIDIA GPUs that the driver lists in this directory."""
    return [
        line.partition(":")[2].strip()
        for file in sorted(drivers.glob("*/information"))
        for line in file.read_text(encoding="utf-8").splitlines()
        if line.startswith("Model:")
    ]


def as_typed(command: str) -> str:
    """Spell a command of this environment so that the user's shell finds it, activated or not."""
    if shutil.which(command):
        return command
    return shlex.quote(os.path.relpath(Path(sys.executable).parent / command))
