"""A Slurm for the tests of a module, and what clusters must give: the results of this machine alone.

Where Slurm is not installed, its tests are skipped, unless TACEVO_SLURM=1 insists.
"""

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from cluster_sweeps import NONE, STUDY, TACEVO, sweep_here
from slurm_cluster import Slurm, missing_programs, slurm_cluster
from smallest import Once


@pytest.fixture(scope="module")
def slurm() -> Iterator[Slurm]:
    """Return a running Slurm of two nodes with two processors each."""
    missing = missing_programs()
    if missing:
        if os.environ.get("TACEVO_SLURM") == "1":
            pytest.fail(f"TACEVO_SLURM=1, but these are missing: {missing}; `apt-get install slurm-wlm munge`")
        pytest.skip(f"no Slurm ({', '.join(missing)} missing): `apt-get install slurm-wlm munge`")
    with slurm_cluster() as cluster:
        yield cluster


@pytest.fixture(scope="session")
def alone(once: Once) -> Path:
    """Return a directory in which the sweep ran on this machine; no test may change it."""
    return once("swept alone", sweep_here)


@pytest.fixture(scope="session")
def studied_alone(once: Once, alone: Path) -> Path:
    """Return the same with a study of a job; no test may change it."""

    def study(folder: Path) -> None:
        shutil.copytree(alone, folder, dirs_exist_ok=True)
        subprocess.run([*TACEVO, "study", f"run=all/{NONE}", *STUDY], cwd=folder, check=True, capture_output=True)

    return once("studied alone", study)
