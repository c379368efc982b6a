"""`ray.sbatch` ends as its command does; Slurm and Ray are stood in for by scripts."""

import os
import subprocess
from pathlib import Path

import pytest

import tacevo

SCRIPT = Path(tacevo.__file__).parent / "cluster" / "ray.sbatch"

#: Stand-ins for one node, which is there at once and notes what it inherits.
_COMMANDS = {
    "scontrol": 'case "$2" in hostnames) echo one;; node) echo "NodeAddr=127.0.0.1 ";; *) echo "$@" >> asked;; esac',
}

_SRUN = "env > inherited; echo Ray runtime started"


def run(folder: Path, *command: str, srun: str = _SRUN) -> "subprocess.CompletedProcess[str]":
    """Run the script as Slurm would, with a file of keys."""
    programs = folder / "bin"
    programs.mkdir()
    for name, text in {**_COMMANDS, "srun": srun}.items():
        (programs / name).write_text(f"#!/bin/bash\n{text}\n")
        (programs / name).chmod(0o755)
    (folder / "keys").write_text("export ANTHROPIC_API_KEY=sk-from-the-file\n")
    own = {"PATH": f"{programs}:{os.environ['PATH']}", "TACEVO_KEYS": str(folder / "keys")}
    slurm = {"SLURM_JOB_ID": "7", "SLURM_JOB_NODELIST": "one"}
    return subprocess.run(
        ["bash", str(SCRIPT), *command],
        cwd=folder,
        env={**own, **slurm},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize("status", [0, 3])
def test_job_ends_as_its_command_that_ends_at_once(status: int, tmp_path: Path) -> None:
    """The job fails where the command does, and is not queued again."""
    ended = run(tmp_path, "bash", "-c", f"exit {status}")
    assert (ended.returncode, ended.stderr) == (status, "")
    assert not (tmp_path / "asked").exists()


def test_node_is_not_told_where_the_keys_are(tmp_path: Path) -> None:
    """The command has the key; Ray has neither the key nor the file's name."""
    ended = run(tmp_path, "bash", "-c", "echo $ANTHROPIC_API_KEY")
    assert ended.stdout == "sk-from-the-file\n"
    inherited = (tmp_path / "inherited").read_text()
    assert "RAY_AUTH_TOKEN=" in inherited
    assert "keys" not in inherited
    assert "sk-from-the-file" not in inherited


def test_warning_while_ray_starts_stops_the_command_and_queues_the_job_again(tmp_path: Path) -> None:
    """The script lives on, and the command is ended as soon as it is there."""
    warn = 'kill -USR1 $PPID; sleep 1; echo "Ray runtime started"'
    ended = run(tmp_path, "sleep", "60", srun=warn)
    assert ended.returncode == 143, ended.stderr
    assert (tmp_path / "asked").read_text() == "requeue 7\n"
