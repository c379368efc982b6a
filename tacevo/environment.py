"""The commit of this project's own checkout, for people who look a run up; it decides nothing."""

import os
import platform
import subprocess
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from tacevo.records import Json

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


def checked_out(root: Path = _ROOT) -> dict[str, Json] | None:
    """Return the commit that a checkout has, 40 hex digits, and whether a file of it was changed since.

    Args:
        root: the top folder of the checkout.

    Returns:
        `commit` and `dirty`; None where the folder is not the top of a Git checkout, or Git gives no answer.
    """
    if not (root / ".git").exists():
        return None
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}  # e.g. of a hook
    try:
        said = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return None
    commit, dirty, _ = said.strip().partition("-dirty")
    return {"commit": commit, "dirty": bool(dirty)}


def versions() -> dict[str, str]:
    """List the versions of Python and of the packages that matter; `absent` where one is not installed."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "absent"
    return found


def deviations(recorded: Mapping[str, Json], here: Mapping[str, Json]) -> tuple[str, ...]:
    """Say in one line each which facts of a run's surroundings are others here.

    Args:
        recorded: of the run: of its `versions` or its `machine`, those that matter.
        here: this environment's, of which those are looked up.
    """
    return tuple(
        f"{name} is {here.get(name)}; the run had {was}" for name, was in recorded.items() if here.get(name) != was
    )


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
        "gpu": gpu(Path("/proc/driver/nvidia/gpus")),
    }


def gpu(drivers: Path) -> str | None:
    """Name the first NVIDIA GPU, as its driver lists it in that folder; None where there is none."""
    for file in sorted(drivers.glob("*/information")):
        for line in file.read_text(encoding="utf-8").splitlines():
            if line.startswith("Model:"):
                return line.partition(":")[2].strip()
    return None
