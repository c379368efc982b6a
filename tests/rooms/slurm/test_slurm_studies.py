"""Promise: processes on several nodes of Slurm divide a study, and give the bytes of one process on this machine."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from cluster_sweeps import FIXED, NONE, STUDY, TACEVO, study_digest
from interruptions import PATIENCE, unhurried
from slurm_cluster import Slurm

pytestmark = [pytest.mark.cluster, unhurried]

#: One task of Slurm on each of its two nodes.
BOTH = ["srun", "--nodes=2", "--ntasks=2", "--ntasks-per-node=1", "--cpus-per-task=2", "--label"]


@pytest.mark.few(1)
@pytest.mark.parametrize("what", [(f"run=all/{NONE}", *STUDY), ("sweep=all", *STUDY[1:])], ids=["run", "sweep"])
def test_study_on_two_nodes_has_the_digest_of_this_machine(
    what: tuple[str, ...], slurm: Slurm, tmp_path: Path, alone: Path, studied_alone: Path
) -> None:
    """Of a run, and of each job of a sweep, by both processes."""
    shutil.copytree(alone, tmp_path, dirs_exist_ok=True)
    done = subprocess.run(
        [*BOTH, *TACEVO, "study", *what],
        cwd=tmp_path,
        env={**os.environ, **slurm.environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert study_digest(tmp_path) == study_digest(studied_alone)
    if "sweep=all" in what:
        assert study_digest(tmp_path, FIXED)
    assert {line.split(":")[0] for line in done.stdout.splitlines() if "digest" in line} == {"0", "1"}, done.stdout
