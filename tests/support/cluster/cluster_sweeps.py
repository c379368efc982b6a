"""A sweep that runs on clusters in tests, and what it gives on this machine alone."""

import shutil
import subprocess
import sys
from pathlib import Path

from smallest import SIMULATED, UNTRACKED

from tacevo.results.study_directory import studies_of
from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.sweeps.status import status_of

#: On a cluster, each job fills a node of two processors.
JOBS = [*SIMULATED, UNTRACKED, "executor.workers=2", "store.root=cache", "search.initial=1", "search.candidates=2"]
SWEEP = [*JOBS, "search.generations=2"]
ENDLESS = [*JOBS, "search.generations=999"]
NONE, FIXED = "none-seed0", "fixed_temperature-seed0"
#: One job, or two.
ONE, TWO = "ablation=none", "ablation=none,fixed_temperature"
#: The command, before its arguments.
TACEVO = [sys.executable, "-P", "-m", "tacevo.cli.app"]
#: Of a study of a job; in that of a sweep, the first goes without saying.
STUDY = ["elites=1", "seeds=2", "epochs=1"]


def sweep_here(folder: Path) -> None:
    """Run both jobs on this machine."""
    subprocess.run([*TACEVO, "search", "-m", *SWEEP, TWO, "--into", "all"], cwd=folder, check=True, capture_output=True)


def study_here(swept: Path, folder: Path) -> None:
    """Copy that sweep, and study a job of it on this machine."""
    shutil.copytree(swept, folder, dirs_exist_ok=True)
    subprocess.run([*TACEVO, "study", f"run=all/{NONE}", *STUDY], cwd=folder, check=True, capture_output=True)


def study_digest(folder: Path, name: str = NONE) -> str | None:
    """Return the digest of the only study of a job; None if it is not finished."""
    (directory,) = studies_of(folder / "all" / name)
    return directory.read().digest


def digest(folder: Path, name: str = NONE) -> str:
    """Return the digest of a job; empty if it is not finished."""
    directory = SweepDirectory(folder / "all")
    job = next(job for job in directory.read().jobs if job.name == name)
    return status_of(directory, job).digest


def has_begun(folder: Path, name: str = NONE) -> bool:
    """Return whether a job has decided something."""
    ledger = folder / "all" / name / "ledger.jsonl"
    return ledger.exists() and ledger.read_bytes().count(b"\n") > 1
