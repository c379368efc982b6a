"""The report page of a finished run: the one that stands in its directory, or one that is made."""

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

#: What the page is called, in the run directory and among MLflow's artifacts.
PAGE = "report.html"

#: Makes the page of a run directory as a file, or leaves no file.
MakePage = Callable[[Path, Path], object]


def import_path() -> dict[str, str]:
    """Return the environment of a process that is to import what this one imports."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(os.path.abspath(path) for path in sys.path)}


def make_page(run_dir: Path, target: Path) -> None:
    """Make the page in a process of its own, by the command that a user would type; where that fails, there is none."""
    command = [sys.executable, "-P", "-m", "tacevo.cli.app", "report", str(run_dir.resolve()), "-o", str(target)]
    subprocess.run(command, env=import_path(), stdin=subprocess.DEVNULL, capture_output=True, check=False)


def current_page(run_dir: Path) -> Path | None:
    """Return the page that stands in the run directory, unless the run has ended since."""
    own, summary = run_dir / PAGE, run_dir / "summary.md"
    if own.exists() and (not summary.exists() or own.stat().st_mtime >= summary.stat().st_mtime):
        return own
    return None


@contextlib.contextmanager
def page_of(run_dir: Path, make: MakePage | None) -> Iterator[Path]:
    """Return the file of the page, which may be missing: the current one, or one that is made elsewhere.

    The run directory is only read.
    """
    own = current_page(run_dir)
    if own is not None or make is None:
        yield own or run_dir / PAGE
        return
    with tempfile.TemporaryDirectory() as folder:
        make(run_dir, Path(folder) / PAGE)
        yield Path(folder) / PAGE
