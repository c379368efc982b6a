"""Promise: what a machine cannot offer is refused by name, and what is said to be in force is."""

import ctypes
import itertools
import multiprocessing
import os
import re
import time
from multiprocessing.connection import Connection
from pathlib import Path

import pytest
from refusals import refused

from tacevo.choices import Confinement
from tacevo.errors import SandboxError
from tacevo.records import Limits
from tacevo.sandbox.confinement import available, check_confinement, confine, in_force, report
from tacevo.sandbox.kernel import can_fix_addresses

LEVELS = list(Confinement)


@pytest.mark.parametrize(("offered", "wanted"), list(itertools.product(LEVELS, LEVELS)))
def test_level_is_granted_where_it_is_offered(offered: Confinement, wanted: Confinement) -> None:
    """A run that demands more than the machine has does not start, and the error says why and what to do."""
    if LEVELS.index(wanted) <= LEVELS.index(offered):
        check_confinement(wanted, offered)
        return
    expected, remedy = f"a machine that offers the level {wanted}", f"set sandbox.require={offered}"
    with refused(SandboxError, place="sandbox.require", expected=expected, got=offered, remedy=remedy):
        check_confinement(wanted, offered)


def test_level_of_this_machine_follows_from_its_walls() -> None:
    """The level that is reported may be demanded, and is kernel only where no wall is reported as missing."""
    described = report()
    assert described["level"] == available()
    check_confinement(available())
    missing = [wall for wall in ("landlock", "seccomp") if described[wall].startswith("missing")]
    assert not (available() is Confinement.kernel and missing)


def _confined(parent: Connection, strongest: Confinement) -> None:
    parent.send(confine(Limits(seconds=7, memory_mib=100), strongest))
    time.sleep(60)  # behind the walls it cannot even read an answer


PRIVILEGES = ("no_new_privs", "not_dumpable", "no_capabilities")


@pytest.mark.parametrize("strongest", LEVELS)
def test_measures_are_in_force_and_reported(strongest: Confinement) -> None:
    """A confined process has no privilege to gain, no capability, hard limits, and the walls that there are.

    The level none leaves the limits of resources out: a driver opens files and reserves addresses.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_confined, args=(theirs, strongest))
    process.start()
    names = set(ours.recv())
    status, limits = (Path(f"/proc/{process.pid}/{name}").read_text() for name in ("status", "limits"))
    process.kill()
    process.join()
    described = report()
    walls = {wall for wall in ("landlock", "seccomp") if not described[wall].startswith("missing")}
    resources = set() if strongest is Confinement.none else {"rlimits"}
    assert names == {*PRIVILEGES} | resources | (walls if strongest is Confinement.kernel else set())
    assert f"Seccomp:\t{2 if 'seccomp' in names else 0}\n" in status
    assert "NoNewPrivs:\t1" in status
    assert "CapEff:\t0000000000000000" in status
    hard = dict(re.findall(r"^Max (.+?) {2,}\S+ +(\S+)", limits, re.MULTILINE))
    limited = [hard[name] for name in ("file size", "open files", "core file size", "cpu time")]
    assert (limited == ["0", "0", "0", "17"]) == ("rlimits" in names)


RESOURCES = (*PRIVILEGES, "rlimits")


@pytest.mark.parametrize(
    ("measures", "level"),
    [
        (PRIVILEGES, Confinement.none),
        (RESOURCES, Confinement.process),
        ((*RESOURCES, "seccomp"), Confinement.process),
        ((*RESOURCES, "landlock", "seccomp"), Confinement.kernel),
    ],
)
def test_what_held_a_candidate_is_told_from_its_measures(measures: tuple[str, ...], level: Confinement) -> None:
    """A measure that was left out is never described as one that holds, whatever the machine has."""
    described = in_force(measures)
    assert described["level"] == level
    for name in {"rlimits", "landlock", "seccomp"} - set(measures):
        assert described[name].startswith(("not in force", "missing"))
    for name in measures:
        assert described[name] == report()[name]


def personality() -> int:
    """Ask the kernel for this thread's; its file in /proc is root's where the process may not be traced."""
    current: int = ctypes.CDLL(None).personality(ctypes.c_ulong(0xFFFFFFFF))
    return current


def test_asking_for_fixed_addresses_changes_nothing() -> None:
    """The report tries what the kernel grants, and leaves the search as it was."""
    before = personality()
    granted = can_fix_addresses()
    assert personality() == before
    assert ("not randomised" in report()["fixed_addresses"]) is granted


def test_system_without_handles_of_processes_confines_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """As another system than Linux, or one before 5.3."""
    monkeypatch.delattr(os, "pidfd_open")
    assert available() is Confinement.none
