"""What lies in a directory that a command wrote."""

import json
import shutil
from pathlib import Path


def contents(folder: Path) -> dict[str, bytes]:
    """Read all files of a directory."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def study_in(run: Path) -> Path:
    """Return the directory of the only study of a run."""
    (path,) = run.glob("studies/*")
    return path


def copy_that_stands_here(published: Path, folder: Path) -> None:
    """Copy the published run and its stores into a folder, as they would be if it had been made where that is."""
    for name in ("run", "cache"):
        shutil.copytree(published / name, folder / name)
    described = json.loads((folder / "run" / "run.json").read_text())
    described["config"]["run"]["dir"], described["config"]["store"]["root"] = "run", "cache"
    (folder / "run" / "run.json").write_text(json.dumps(described))
