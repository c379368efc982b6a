"""What lies in a directory that a command wrote."""

from pathlib import Path


def contents(folder: Path) -> dict[str, bytes]:
    """Read all files of a directory."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def study_in(run: Path) -> Path:
    """Return the directory of the only study of a run."""
    (path,) = run.glob("studies/*")
    return path
