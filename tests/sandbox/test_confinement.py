"""Promise: what a machine cannot offer is refused by name, and what is said to be in force is."""

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


@pytest.mark.parametrize(("weaker", "wanted"), list(itertools.combinations(LEVELS, 2)))
def test_level_that_is_not_offered_is_refused(weaker: Confinement, wanted: Confinement) -> None:
    """A run that demands more than the machine has does not start, and the error says why and what to do."""
    expected, remedy = f"a machine that offers the level {wanted}", f"set sandbox.require={weaker}"
    with refused(SandboxError, place="sandbox.require", expected=expected, got=weaker, remedy=remedy):
        check_confinement(wanted, weaker)


def is_granted(wanted: Confinement, offered: Confinement) -> bool:
    """Return whether a run that demands a level starts on a machine that offers another."""
    try:
        check_confinement(wanted, offered)
    except SandboxError:
        return False
    return True


@pytest.mark.parametrize("offered", LEVELS)
def test_level_that_is_offered_is_granted(offered: Confinement) -> None:
    """Asking for what there is, or for less, is fine."""
    assert [level for level in LEVELS if is_granted(level, offered)] == LEVELS[: LEVELS.index(offered) + 1]


def test_what_this_machine_has_is_granted() -> None:
    """The level that is reported is the one that a run may demand."""
    assert report()["level"] == available()
    check_confinement(available())


@pytest.mark.parametrize("wall", ["landlock", "seccomp"])
def test_level_follows_from_the_walls(wall: str) -> None:
    """The level is kernel only where no wall is reported as missing."""
    assert not (available() is Confinement.kernel and report()[wall].startswith("missing"))


def _confined(parent: Connection, strongest: Confinement) -> None:
    parent.send(confine(Limits(seconds=7, memory_mib=100), strongest))
    time.sleep(60)  # behind the walls it cannot even read an answer


@pytest.mark.parametrize("strongest", [Confinement.process, Confinement.kernel])
def test_measures_are_in_force_and_reported(strongest: Confinement) -> None:
    """A confined process has no privilege to gain, no capability, hard limits, and the walls that there are."""
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
    assert names <= described.keys()
    assert names & {"landlock", "seccomp"} == (walls if strongest is Confinement.kernel else set())
    assert f"Seccomp:\t{2 if 'seccomp' in names else 0}\n" in status
    assert "NoNewPrivs:\t1" in status
    assert "CapEff:\t0000000000000000" in status
    hard = dict(re.findall(r"^Max (.+?) {2,}\S+ +(\S+)", limits, re.MULTILINE))
    found = [hard[name] for name in ("file size", "open files", "core file size", "cpu time")]
    assert found == ["0", "0", "0", "17"]


def test_level_none_leaves_the_limits_of_resources_out() -> None:
    """A driver opens files and reserves addresses; privileges and capabilities are given up all the same."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_confined, args=(theirs, Confinement.none))
    process.start()
    names = set(ours.recv())
    process.kill()
    process.join()
    assert names == {"no_new_privs", "not_dumpable", "no_capabilities"}


RESOURCES = ("no_new_privs", "not_dumpable", "no_capabilities", "rlimits")


@pytest.mark.parametrize(
    ("measures", "level"),
    [
        (RESOURCES[:3], Confinement.none),
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


def test_asking_for_fixed_addresses_changes_nothing() -> None:
    """The report tries what the kernel grants, and leaves the search as it was."""
    before = Path("/proc/thread-self/personality").read_text()
    granted = can_fix_addresses()
    assert Path("/proc/thread-self/personality").read_text() == before
    assert ("not randomised" in report()["fixed_addresses"]) is granted


def test_system_without_handles_of_processes_confines_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """As another system than Linux, or one before 5.3."""
    monkeypatch.delattr(os, "pidfd_open")
    assert available() is Confinement.none
