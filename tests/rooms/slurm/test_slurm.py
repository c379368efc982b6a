"""Promise: a sweep on Slurm has the digests that its searches have on this machine, whatever Slurm does to its jobs.

The Slurm is a real one (`slurm_cluster`), the searches are as small as they can be.
"""

import os
import signal
import subprocess
from pathlib import Path

import pytest
from cluster_sweeps import ENDLESS, FIXED, NONE, ONE, SWEEP, TACEVO, TWO, digest, has_begun
from interruptions import PATIENCE, comes, ends, processes_of, unhurried
from slurm_cluster import Slurm

pytestmark = [pytest.mark.cluster, unhurried]

SLURM = "hydra/launcher=submitit_slurm"
#: No key may reach Slurm; this one is looked for wherever it could lie.
KEY = "sk-never-to-be-seen"


def start(slurm: Slurm, folder: Path, *overrides: str) -> subprocess.Popen[str]:
    """Start a sweep on Slurm in a directory, with a key in its environment."""
    (folder / "tmp").mkdir(exist_ok=True)
    own = {"TMPDIR": str(folder / "tmp"), "OMP_NUM_THREADS": "1", "ANTHROPIC_API_KEY": KEY}
    return subprocess.Popen(
        [*TACEVO, "search", "-m", *overrides, SLURM, "--into", "all"],
        cwd=folder,
        env={**os.environ, **slurm.environment, **own},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def ended(sweep: subprocess.Popen[str], status: int = 0) -> str:
    """Wait for the end of a sweep with an exit status; return what it printed."""
    out, errors = sweep.communicate(timeout=PATIENCE)
    assert sweep.returncode == status, out + errors
    return out


def interrupted(slurm: Slurm, sweep: subprocess.Popen[str], folder: Path) -> str:
    """Wait until the job has decided something and has not ended; return its id in Slurm."""
    assert comes(sweep, lambda: has_begun(folder))
    (job,) = slurm.running()
    return job


def test_sweep_on_two_nodes_has_the_digests_of_this_machine_and_no_key_reaches_slurm(
    slurm: Slurm, tmp_path: Path, alone: Path
) -> None:
    """Jobs run at once on both; neither Slurm's state nor a job's script, pickle, log or environment holds the key."""
    (tmp_path / "random.py").write_text("raise SystemExit('a job imports what lies where it was submitted')")
    sweep = start(slurm, tmp_path, *SWEEP, TWO)
    assert comes(sweep, lambda: len(slurm.running()) == 2 and len(_searches(tmp_path)) == 2)
    assert {slurm.node_of(job) for job in slurm.running()} == set(slurm.nodes)
    environments = [(process / "environ").read_bytes() for process in _searches(tmp_path)]
    assert all(b"SLURM_JOB_ID" in each and KEY.encode() not in each for each in environments)
    assert not _files_with(KEY, slurm.folder, tmp_path)
    out = ended(sweep)
    assert "2 jobs: 2 finished" in out
    for name in (NONE, FIXED):
        assert digest(tmp_path, name) == digest(alone, name)
    assert not _files_with(KEY, slurm.folder, tmp_path)


def test_key_reaches_jobs_through_a_file_and_lies_nowhere_else(slurm: Slurm, tmp_path: Path) -> None:
    """`hydra.launcher.setup` names a file that only its owner reads; its key is in the environment of the search."""
    keys = tmp_path / "keys"
    keys.touch(mode=0o600)
    keys.write_text("export ANTHROPIC_API_KEY=sk-from-the-file\n")
    sweep = start(slurm, tmp_path, *ENDLESS, ONE, f'hydra.launcher.setup=[". {keys}"]')
    assert comes(sweep, lambda: len(_searches(tmp_path)) == 1)
    (search,) = _searches(tmp_path)
    assert b"ANTHROPIC_API_KEY=sk-from-the-file\0" in (search / "environ").read_bytes()
    assert _files_with("sk-from-the-file", slurm.folder, tmp_path) == [keys]
    sweep.send_signal(signal.SIGINT)
    ended(sweep, status=130)
    assert _files_with("sk-from-the-file", slurm.folder, tmp_path) == [keys]
    assert not _files_with(KEY, slurm.folder, tmp_path)


def expect_resumed(folder: Path, alone: Path) -> None:
    """Expect that a search went on from what it had, to the digest of this machine."""
    assert "resumed after" in (folder / "all" / "launch" / f"{NONE}.log").read_text()
    assert digest(folder) == digest(alone)


def test_cancelled_job_is_a_failure_and_the_same_command_resumes_it(slurm: Slurm, tmp_path: Path, alone: Path) -> None:
    """The command ends, though Slurm has no accounting; the next one ends the search."""
    sweep = start(slurm, tmp_path, *SWEEP, ONE)
    slurm.run("scancel", interrupted(slurm, sweep, tmp_path))
    assert "Slurm: CANCELLED" in ended(sweep, status=1)
    assert ends(tmp_path), processes_of(tmp_path)
    assert not digest(tmp_path)
    ended(start(slurm, tmp_path, *SWEEP, ONE))
    expect_resumed(tmp_path, alone)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["requeue", "warning", "dead node"])
def test_job_that_slurm_queues_again_continues_by_itself(how: str, slurm: Slurm, tmp_path: Path, alone: Path) -> None:
    """The command waits for the second attempt, though the first one has left a result.

    A warning of the end of its time queues a job again with `max_num_timeout`; the job of a dead node goes to another.
    """
    again = ["hydra.launcher.timeout_min=9", "hydra.launcher.max_num_timeout=1"] if how == "warning" else []
    sweep = start(slurm, tmp_path, *SWEEP, ONE, *again)
    job = interrupted(slurm, sweep, tmp_path)
    node = slurm.node_of(job)
    match how:
        case "requeue":
            slurm.run("scontrol", "requeue", job)
        case "warning":
            slurm.run("scancel", "--signal=USR2", job)
        case "dead node":
            slurm.kill_node(node)
    ended(sweep)
    if how == "dead node":
        slurm.start_node(node)
    expect_resumed(tmp_path, alone)


@pytest.mark.slow
def test_warning_stops_a_search_as_ctrl_c_does(slurm: Slurm, tmp_path: Path) -> None:
    """Slurm sends it to every process of the job; it kills none, and the job is listed as out of time."""
    sweep = start(slurm, tmp_path, *ENDLESS, ONE, "hydra.launcher.timeout_min=9")
    slurm.run("scancel", "--signal=USR2", interrupted(slurm, sweep, tmp_path))
    assert "out of time" in ended(sweep, status=1)
    assert "interrupted; what was computed is kept" in (tmp_path / "all" / "launch" / f"{NONE}.log").read_text()


@pytest.mark.slow
def test_job_out_of_time_is_stopped_and_the_same_command_resumes_it(slurm: Slurm, tmp_path: Path, alone: Path) -> None:
    """Slurm ends it at its real limit, a minute, even where the search hangs and hears nothing."""
    sweep = start(slurm, tmp_path, *SWEEP, ONE, "hydra.launcher.timeout_min=1", "hydra.launcher.signal_delay_s=5")
    interrupted(slurm, sweep, tmp_path)
    (search,) = _searches(tmp_path)
    os.kill(int(search.name), signal.SIGSTOP)
    out = ended(sweep, status=1)
    assert "Slurm: TIMEOUT" in out or "out of time" in out
    assert ends(tmp_path), processes_of(tmp_path)
    ended(start(slurm, tmp_path, *SWEEP, ONE))
    assert digest(tmp_path) == digest(alone)


def test_ctrl_c_cancels_the_jobs(slurm: Slurm, tmp_path: Path) -> None:
    """When the command has ended, nothing of it is queued or running."""
    sweep = start(slurm, tmp_path, *ENDLESS, f"{TWO},no_qd")
    assert comes(sweep, lambda: len(slurm.running()) == 2 and len(_searches(tmp_path)) == 2)
    assert not slurm.is_idle()
    sweep.send_signal(signal.SIGINT)
    ended(sweep, status=130)
    assert slurm.is_idle()
    assert ends(tmp_path), processes_of(tmp_path)


def _searches(folder: Path) -> list[Path]:
    """Return the searches of a sweep's jobs, as directories in /proc."""
    processes = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            words = (process / "cmdline").read_bytes().split(b"\0")
            stands_here = (process / "cwd").readlink() == folder
        except OSError:
            continue
        if b"search" in words and b"-m" in words[1:4] and b"--into" not in words and stands_here:
            processes.append(process)
    return processes


def _files_with(text: str, *folders: Path) -> list[Path]:
    """List the files that hold a text."""
    files = [path for folder in folders for path in folder.rglob("*") if path.is_file()]
    return [path for path in files if text.encode() in path.read_bytes()]
