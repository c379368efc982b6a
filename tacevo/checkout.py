"""The commit of this project's own checkout, for people who look a run up; it decides nothing."""

import os
import subprocess
from pathlib import Path

from tacevo.records import Json

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
