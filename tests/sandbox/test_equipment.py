"""Promise: a device is made ready before a job's process is confined, and its failure is never a verdict."""

import pytest
from refusals import refused

from tacevo.errors import SandboxError
from tacevo.records import Limits
from tacevo.sandbox.client import Finished, Frame, Sandbox

LIMITS = Limits(seconds=20, memory_mib=300)

pytestmark = pytest.mark.timeout(60)


def test_device_is_made_ready_before_the_walls_and_its_failure_says_nothing_of_a_candidate() -> None:
    """What `equip` returns reaches the entry, which is confined; a job that it fails for raises, and others run."""
    entries, settings = {"tell": "equipping:tell"}, {"OMP_NUM_THREADS": "1"}
    with Sandbox(entries=entries, environment=settings, arrays={}, equip="equipping:equip") as sandbox:
        assert sandbox.run("tell", None, b"", LIMITS) == Finished((Frame(["Name:", True], b""),))
        with refused(SandboxError, expected="a sandbox that works", got="RuntimeError: CUDA error: out of memory"):
            sandbox.run("tell", "fail", b"", LIMITS)
        assert sandbox.run("tell", None, b"", LIMITS) == Finished((Frame(["Name:", True], b""),))
