"""What holds a candidate inside its process, and what this machine can offer of it.

Two levels. The measures of `process` need no special kernel: limits of resources, no privileges, no capabilities, a
supervisor. Those of `kernel` are walls that the process cannot take down again: Landlock and a seccomp filter. They
are used wherever the kernel has them, whatever a run demands. See docs/security.md for what follows from each
measure, and what does not.
"""

import os
import resource
from collections.abc import Collection

from tacevo.choices import Confinement
from tacevo.errors import SandboxError
from tacevo.records import Limits
from tacevo.sandbox import landlock, seccomp
from tacevo.sandbox.kernel import can_fix_addresses, drop_capabilities, protect_memory, renounce_privileges
from tacevo.sandbox.processes import address_space_mib

#: Address space beyond the zygote's and the memory limit that allocators reserve without using it, in MiB.
_SLACK_MIB = 1024

#: CPU seconds beyond the wall-time limit; a backstop for a supervisor that is stopped.
_CPU_SLACK = 10

#: The measures that make the level `kernel`.
_WALLS = frozenset({"landlock", "seccomp"})


def available() -> Confinement:
    """Say the strongest level that this machine has."""
    if not (hasattr(os, "pidfd_open") and os.path.exists("/proc/thread-self/children")):
        return Confinement.none
    return Confinement.kernel if landlock.version() and seccomp.is_available() else Confinement.process


def require(level: Confinement) -> None:
    """Refuse to go on where candidates cannot be confined as strongly as asked.

    Raises:
        SandboxError: the level is not available.
    """
    refuse_weaker(available(), wanted=level)


def refuse_weaker(offered: Confinement, *, wanted: Confinement) -> None:
    """Refuse a level that a machine does not offer.

    Raises:
        SandboxError: the level wanted is stronger than the one offered.
    """
    levels = list(Confinement)
    if levels.index(wanted) > levels.index(offered):
        raise SandboxError(
            f"sandbox.require={wanted} is not available here; the strongest level is {offered!s}, because "
            f"{_missing(offered)} (`tacevo doctor` lists what there is). Use another machine, or accept less with "
            f"sandbox.require={offered!s}"
        )


def _missing(offered: Confinement) -> str:
    if offered is Confinement.none:
        return "it needs Linux 5.3 or later with /proc/<pid>/task/<tid>/children"
    return "the kernel lacks Landlock (5.13 or later), or seccomp filters on x86-64 or aarch64"


def report() -> dict[str, str]:
    """Describe every measure that this machine has in a line: what it does, or why it is missing."""
    known = landlock.version()
    return {
        "level": available().value,
        "session": "each candidate has its own session, working directory / and no inherited file",
        "environment": "cleared; only the numeric settings are given",
        "rlimits": "address space and CPU time; no file or socket can be opened, no byte written, no core dumped",
        "no_new_privs": "set-user-id programs gain nothing",
        "not_dumpable": "no process of the same user may trace it or read its memory",
        "no_capabilities": "a candidate of root has none of root's powers",
        "supervisor": "time and memory limits kill the whole process tree",
        "fixed_addresses": "addresses are not randomised; mapped libraries lie in the same place in every run"
        if can_fix_addresses()
        else "refused by the kernel: a candidate whose result hangs on addresses may differ between runs",
        "landlock": f"version {known}: no access to files{', network' * (known >= landlock.NETWORK_SINCE)}"
        f"{', processes outside' * (known >= landlock.SCOPES_SINCE)}"
        if known
        else "missing: the kernel has none, or it is switched off (Linux 5.13 or later, `lsm=landlock,...`)",
        "seccomp": "a short list of system calls is left; no process or thread can be started, nobody else signalled"
        if seccomp.is_available()
        else "missing: the kernel takes no filter, or this is neither x86-64 nor aarch64",
    }


def in_force(measures: Collection[str]) -> dict[str, str]:
    """Describe what held a candidate, for `tacevo doctor` and run.json.

    Args:
        measures: the names that `confine` returned in the candidate's process.

    Returns:
        The lines of `report`, with the level that the candidate was held at, and those measures named that this
        machine has and the run left out.
    """
    lines = report()
    absent = [
        name
        for name in ("landlock", "seccomp", "rlimits")
        if name not in measures and not lines[name].startswith("missing")
    ]
    left_out = dict.fromkeys(absent, "not in force: left out, as training.device=cuda needs")
    return lines | left_out | {"level": _level(measures).value}


def _level(measures: Collection[str]) -> Confinement:
    if "rlimits" not in measures:
        return Confinement.none
    return Confinement.kernel if _WALLS.issubset(measures) else Confinement.process


def confine(limits: Limits, strongest: Confinement) -> tuple[str, ...]:
    """Give up, for good, what this process does not need as a candidate; called in the child, before its source.

    Args:
        limits: what the candidate may use.
        strongest: the level whose measures are taken, those that this machine has.

    Returns:
        The names of the measures in force, as `report` spells them.

    Raises:
        OSError: the kernel refused a measure that it has.
    """
    names = ["no_new_privs", "not_dumpable", "no_capabilities"]
    inherited_mib = address_space_mib()  # read from a file, hence first
    renounce_privileges()
    if strongest is Confinement.kernel and landlock.version():
        landlock.restrict()
        names.append("landlock")
    if strongest is not Confinement.none:  # a device driver opens files and reserves addresses without end
        _limit_resources(limits, inherited_mib)
        names.append("rlimits")
    protect_memory()
    drop_capabilities()
    if strongest is Confinement.kernel and seccomp.is_available():
        seccomp.restrict()  # the last, because the other measures need calls that it refuses
        names.append("seccomp")
    return tuple(names)


def _limit_resources(limits: Limits, inherited_mib: float) -> None:
    """Set the limits that the kernel keeps for each process by itself; hard limits, so they cannot be raised."""
    space = int((inherited_mib + limits.memory_mib + _SLACK_MIB) * 2**20)
    seconds = int(limits.seconds) + _CPU_SLACK
    for kind, value in (
        (resource.RLIMIT_AS, space),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_NOFILE, 0),  # what is open stays open; no file, socket or pipe can be added
    ):
        resource.setrlimit(kind, (value, value))
