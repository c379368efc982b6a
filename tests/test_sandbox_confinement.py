"""Promise: what a machine cannot offer is refused by name, and what is said to be in force is."""

import multiprocessing
import resource
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from tacevo.choices import Confinement
from tacevo.errors import SandboxError
from tacevo.records import Limits
from tacevo.sandbox.confinement import available, can_fix_addresses, confine, report, require


def test_kernel_level_is_refused_for_now() -> None:
    """A run that demands the kernel's walls does not start without them."""
    with pytest.raises(
        SandboxError, match=r"sandbox.require=kernel is not available here; the strongest level is process"
    ):
        require(Confinement.kernel)


@pytest.mark.parametrize("level", [Confinement.none, Confinement.process])
def test_weaker_level_than_available_is_granted(level: Confinement) -> None:
    """Asking for less than there is is fine."""
    assert available() is Confinement.process
    require(level)


def _confined(parent: Connection) -> None:
    names = confine(Limits(seconds=7, memory_mib=100))
    kinds = (resource.RLIMIT_FSIZE, resource.RLIMIT_NOFILE, resource.RLIMIT_CORE, resource.RLIMIT_CPU)
    parent.send((names, [resource.getrlimit(kind) for kind in kinds]))
    parent.recv()


def test_measures_are_in_force_and_reported() -> None:
    """A confined process has no privilege to gain, no capability, and hard limits."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_confined, args=(theirs,))
    process.start()
    names, limits = ours.recv()
    status = Path(f"/proc/{process.pid}/status").read_text()
    ours.send("end")
    process.join()
    assert set(names) <= report().keys()
    assert "NoNewPrivs:\t1" in status
    assert "CapEff:\t0000000000000000" in status
    assert limits == [(0, 0), (0, 0), (0, 0), (17, 17)]


def test_asking_for_fixed_addresses_changes_nothing() -> None:
    """The report tries what the kernel grants, and leaves the search as it was."""
    before = Path("/proc/thread-self/personality").read_text()
    granted = can_fix_addresses()
    assert Path("/proc/thread-self/personality").read_text() == before
    assert ("not randomised" in report()["fixed_addresses"]) is granted
