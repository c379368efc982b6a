"""Promise: processes on several nodes of Slurm divide a study, and give the bytes of one process on this machine."""

import shutil
import subprocess
from pathlib import Path

import pytest
from cluster_sweeps import NONE, STUDY, TACEVO
from interruptions import PATIENCE, unhurried
from slurm_cluster import Slurm

from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.studies.directory import studies_of

pytestmark = [pytest.mark.cluster, unhurried]

#: One task of Slurm on each of its two nodes.
BOTH = ["srun", "--nodes=2", "--ntasks=2", "--ntasks-per-node=1", "--cpus-per-task=2", "--label"]


@pytest.mark.parametrize("what", [f"run=all/{NONE}", "sweep=all"])
def test_study_on_two_nodes_has_the_digest_of_this_machine(
    what: str, slurm: Slurm, tmp_path: Path, alone: Path, studied_alone: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a run, and of each job of a sweep, by both processes."""
    shutil.copytree(alone, tmp_path, dirs_exist_ok=True)
    for name, value in slurm.environment.items():
        monkeypatch.setenv(name, value)
    done = subprocess.run(
        [*BOTH, *TACEVO, "study", what, *STUDY],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (here,), (there,) = (studies_of(folder / "all" / NONE) for folder in (studied_alone, tmp_path))
    assert there.read().digest == here.read().digest
    jobs = SweepDirectory(tmp_path / "all").read()[1] if what == "sweep=all" else ()
    assert all(len(studies_of(tmp_path / "all" / job.name)) == 1 for job in jobs)
    assert {line.split(":")[0] for line in done.stdout.splitlines() if "digest" in line} == {"0", "1"}, done.stdout
