"""Promise: a process is seen as it is: running, ending or gone, also where its first thread has ended."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from waiting import eventually

from tacevo.sandbox.processes import children, end_tree, is_ending, memory

LEADERLESS = """
import attacks
attacks.fill_memory_without_leader(None, b"", {}, lambda header, payload: None)
"""

FAMILY = """
import attacks
attacks.fill_memory_in_fork_without_leader(None, b"", {}, lambda header, payload: None)
"""


@pytest.fixture
def leaderless() -> Iterator[int]:
    """Return a process whose first thread has ended, while another holds 400 MiB."""
    with subprocess.Popen([sys.executable, "-c", LEADERLESS], env=_environment()) as process:
        try:
            assert eventually(lambda: _state(process.pid) == "Z")
            yield process.pid
        finally:
            process.kill()


def _environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


def _state(pid: int) -> str:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]


def test_running_process_is_not_ending() -> None:
    """A process that looks at itself is alive and holds memory."""
    assert not is_ending(os.getpid())
    assert memory(os.getpid()).anonymous > 0


def test_zombie_is_ending_and_what_was_reaped_is_gone() -> None:
    """A process that waits to be reaped is on its way; neither holds anything."""
    with subprocess.Popen(["true"]) as process:
        assert eventually(lambda: _state(process.pid) == "Z")
        for reap in (False, True):
            if reap:
                process.wait()
            assert is_ending(process.pid)
            assert memory(process.pid).peak == 0


def test_process_without_its_first_thread_is_not_ending(leaderless: int) -> None:
    """An ended first thread says nothing of the others, whose memory counts."""
    assert not is_ending(leaderless)
    assert eventually(lambda: memory(leaderless).anonymous > 400)


def test_end_of_a_tree_takes_a_process_without_its_first_thread_along() -> None:
    """It is killed like any other."""
    with subprocess.Popen([sys.executable, "-c", FAMILY], env=_environment()) as parent:
        try:
            assert eventually(lambda: any(_state(child) == "Z" for child in children(parent.pid)))
            (child,) = children(parent.pid)
        finally:
            end_tree(parent.pid)
    assert eventually(lambda: not Path(f"/proc/{child}").exists())


def test_process_whose_parent_is_gone_already_ends_itself() -> None:
    """The kernel's signal would never come."""
    orphan = "from tacevo.sandbox.kernel import end_with; end_with(1 << 22); print('alive')"
    done = subprocess.run([sys.executable, "-c", orphan], env=_environment(), capture_output=True, check=False)
    assert (done.returncode, done.stdout) == (1, b"")
