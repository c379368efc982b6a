"""Promise: `ray.sbatch` runs a command on the nodes of one Slurm job, and continues it after the job's time is out."""

import json
import os
import shutil
import sys
from pathlib import Path

import pytest
from cluster_sweeps import NONE, STUDY, SWEEP, TACEVO, digest, study_digest
from interruptions import PATIENCE, ends, processes_of, unhurried
from slurm_cluster import Slurm
from waiting import eventually

import tacevo

pytestmark = [pytest.mark.cluster, unhurried]

SCRIPT = Path(tacevo.__file__).parent / "cluster" / "ray.sbatch"
#: Two nodes of Slurm are one machine here, whose ports Ray's nodes must not fight for.
RAY = "--min-worker-port=0 --max-worker-port=0 --object-store-memory=80000000"
KEY, SHELL_KEY = "sk-from-the-file", "sk-of-the-shell"


def submit(slurm: Slurm, folder: Path, *command: str) -> str:
    """Submit a command on two nodes with a slot each; return the job's id."""
    keys = folder / "keys"
    keys.touch(mode=0o600)
    keys.write_text(f"export ANTHROPIC_API_KEY={KEY}\n")
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    own = {"PATH": path, "TACEVO_RAY": RAY, "TACEVO_KEYS": str(keys), "ANTHROPIC_API_KEY": SHELL_KEY}
    size = ["--nodes=2", "--cpus-per-task=1", f"--chdir={folder}", f"--output={folder / 'out'}"]
    return slurm.run("sbatch", "--parsable", *size, str(SCRIPT), *TACEVO, *command, "executor=ray", **own)


def finish(slurm: Slurm, folder: Path, job: str) -> str:
    """Wait for the end of a job that succeeds; return what it printed."""
    assert eventually(lambda: slurm.jobs()[job] in {"COMPLETED", "FAILED", "CANCELLED"}, seconds=PATIENCE)
    out = (folder / "out").read_text()
    assert slurm.jobs()[job] == "COMPLETED", out
    return out


def has_begun(folder: Path) -> bool:
    """Return whether the search has decided something."""
    ledger = folder / "run" / "ledger.jsonl"
    return ledger.exists() and ledger.read_bytes().count(b"\n") > 1


@pytest.mark.slow
def test_search_on_two_nodes_continues_when_its_time_is_out_and_its_key_stays_in_its_process(
    slurm: Slurm, tmp_path: Path, alone: Path
) -> None:
    """The warning stops the search and queues the job again; the digest is that of this machine."""
    job = submit(slurm, tmp_path, "search", *SWEEP, "ablation=none", "run.dir=run")
    assert eventually(lambda: has_begun(tmp_path), seconds=PATIENCE), (tmp_path / "out").read_text()
    assert set(slurm.run("scontrol", "show", "hostnames", slurm.node_of(job)).split()) == set(slurm.nodes)
    assert "cluster: 2 nodes, 2 slots" in (tmp_path / "out").read_text()
    held = _environments_with(KEY)
    assert held
    assert not any(b"raylet" in command or b"ray::" in command for command in held), held
    for key in (KEY, SHELL_KEY):
        assert not [path for path in slurm.folder.rglob("*") if path.is_file() and key.encode() in path.read_bytes()]
    slurm.run("scancel", "--batch", "--signal=USR1", job)
    assert "resumed after" in finish(slurm, tmp_path, job)
    assert json.loads((tmp_path / "run" / "run.json").read_text())["digest"] == digest(alone)
    assert ends(tmp_path), processes_of(tmp_path)
    assert KEY not in (tmp_path / "out").read_text()


def test_study_on_two_nodes_has_the_digest_of_this_machine(
    slurm: Slurm, tmp_path: Path, alone: Path, studied_alone: Path
) -> None:
    """As a search; the run and its stores are copied."""
    shutil.copytree(alone, tmp_path, dirs_exist_ok=True)
    finish(slurm, tmp_path, submit(slurm, tmp_path, "study", f"run=all/{NONE}", *STUDY))
    assert study_digest(tmp_path) == study_digest(studied_alone)


def _environments_with(text: str) -> list[bytes]:
    """List the commands of the living processes that hold a text in their environment."""
    commands = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if text.encode() in (process / "environ").read_bytes():
                commands.append((process / "cmdline").read_bytes())
        except OSError:
            continue
    return commands
