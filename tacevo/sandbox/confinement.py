"""The measures that confine a candidate to its process, and those of them that this machine has.

There are two levels. The measures of `process` need no special kernel: limits of resources, no privileges, no
capabilities, a supervisor. Those of `kernel` are walls that the process cannot remove again: Landlock and a seccomp
filter. They are used wherever the kernel has them, even if a run does not demand them. docs/security.md says what
follows from each measure, and what does not.

With a GPU the walls have doors for its driver, and stand only where a run demands them: they have not been seen to hold
a driver that works.
"""

import os
from collections.abc import Collection, Sequence

from tacevo.choices import Confinement
from tacevo.errors import SandboxError
from tacevo.records import Limits
from tacevo.sandbox import devices, landlock, seccomp
from tacevo.sandbox.kernel import can_fix_addresses, drop_capabilities, protect_memory, renounce_privileges
from tacevo.sandbox.processes import address_space_mib

try:
    import resource  # here, since a confined process imports nothing any more
except ImportError:  # Windows, which has no sandbox
    resource = None  # type: ignore[assignment]

#: Address space beyond the zygote's and the memory limit that allocators reserve without using it, in MiB.
_SLACK_MIB = 1024
#: CPU seconds beyond the wall-time limit; a backstop for a supervisor that is stopped.
_CPU_SLACK = 10
#: The measures that make the level `kernel`.
_WALLS = frozenset({"landlock", "seccomp"})
#: The name of what leaves a driver its doors, beside those of the walls.
_DOORS = "gpu"
#: The effects of the measures where these doors are.
_WITH_DOORS = {
    "rlimits": "CPU time; nothing written, no core dumped",
    "landlock": "no access to files but the GPU's device files, nor to the network; threads that the driver started "
    "before may read libraries, /proc and /sys",
    "seccomp": "a short list of system calls is left, with those of the GPU's driver; no process can be started, but "
    "threads can; no other is signalled",
    _DOORS: "device files of the GPU can be opened, and commands of its driver given: the driver is trusted",
}

#: The lacks of a machine that allow no stronger level.
_MISSING = {
    Confinement.none: "not Linux 5.3 or later with /proc/<pid>/task/<tid>/children",
    Confinement.process: "a kernel without Landlock (5.13 or later), or without seccomp filters on x86-64 or aarch64",
}


def available() -> Confinement:
    """Return the strongest level that this machine has."""
    if not (hasattr(os, "pidfd_open") and os.path.exists("/proc/thread-self/children")):
        return Confinement.none
    return Confinement.kernel if landlock.version() and seccomp.is_available() else Confinement.process


def check_confinement(level: Confinement, offered: Confinement | None = None) -> None:
    """Check that a machine confines candidates as strongly as a run demands: one that offers a level, or this one.

    Raises:
        SandboxError: the level is stronger than the one offered, or this machine has no sandbox at all.
    """
    if offered is None and (offered := available()) is Confinement.none:
        raise SandboxError(
            _MISSING[offered],
            expected="Linux on x86-64 or aarch64, whose sandbox every candidate runs in",
            remedy="search, study and retrain there; replay, show, tables, figures and report need no sandbox",
        )
    levels = list(Confinement)
    if levels.index(level) > levels.index(offered):
        raise SandboxError(
            f"{offered}: {_MISSING[offered]}",
            place="sandbox.require",
            expected=f"a machine that offers the level {level}",
            remedy=f"use another machine, or set sandbox.require={offered} (`tacevo doctor` lists the measures)",
        )


def report() -> dict[str, str]:
    """Describe every measure in one line: what it does, or why this machine lacks it."""
    if available() is Confinement.none:
        return {"level": Confinement.none.value, "sandbox": f"missing: {_MISSING[Confinement.none]}"}
    known = landlock.version()
    return {
        "level": available().value,
        "session": "each candidate has its own session, working directory / and no inherited file",
        "environment": "cleared, except for the numeric settings",
        "rlimits": "address space and CPU time; no file or socket can be opened, nothing written, no core dumped",
        "no_new_privs": "set-user-id programs gain no privileges",
        "not_dumpable": "no process of the same user may trace it or read its memory",
        "no_capabilities": "a candidate run by root has none of root's powers",
        "supervisor": "kills the whole process tree at the limits of time and memory",
        "fixed_addresses": "addresses are not randomised; mapped libraries lie in the same place in every run"
        if can_fix_addresses()
        else "refused by the kernel: a candidate whose result depends on addresses may differ between runs",
        "landlock": f"version {known}: no access to files{', network' if known >= landlock.NETWORK_SINCE else ''}"
        f"{', processes outside' if known >= landlock.SCOPES_SINCE else ''}"
        if known
        else "missing: it needs Linux 5.13 or later, and may be switched off (`lsm=landlock,...`)",
        "seccomp": "a short list of system calls is left; no process or thread can be started, no other signalled"
        if seccomp.is_available()
        else "missing: the kernel does not accept filters, or this is neither x86-64 nor aarch64",
    }


def in_force(measures: Collection[str]) -> dict[str, str]:
    """Describe what confined a candidate, for `tacevo doctor` and run.json, from what `confine` returned there.

    Return the lines of `report`, with the level that the candidate was confined at; measures that this machine has and
    the run left out are named as such.
    """
    lines = report() | (_WITH_DOORS if _DOORS in measures else {})
    absent = [name for name in (*_WALLS, "rlimits") if name not in measures and not lines[name].startswith("missing")]
    left_out = dict.fromkeys(absent, "not in force: left out, as training.device=cuda needs")
    level = Confinement.kernel if _WALLS.issubset(measures) else Confinement.process
    return lines | left_out | {"level": level.value if "rlimits" in measures else Confinement.none.value}


def shut_out(doors: Sequence[str]) -> None:
    """Leave a process, before the driver of its GPU starts, only what that reads, and its device files.

    Landlock and capabilities are a thread's: those that the driver starts have what this one has by then, so this comes
    first. Nothing of a candidate has run.

    Args:
        doors: paths of device files.

    Raises:
        OSError: the kernel refused it, or has no Landlock.
    """
    renounce_privileges()
    landlock.restrict(readable=devices.readable(), devices=doors)
    drop_capabilities()


def confine(limits: Limits, strongest: Confinement, doors: Sequence[str] = ()) -> tuple[str, ...]:
    """Drop, for good, what a candidate does not need; called in the child before its source runs.

    The measures of the level `strongest` are taken, as far as this machine has them. With `doors`, paths of device
    files, a driver is left what it needs, after `shut_out`. Return the names of those in force, as in `report`.

    Raises:
        OSError: the kernel refused a measure that it has.
    """
    names = ["no_new_privs", "not_dumpable", "no_capabilities"]
    inherited_mib = address_space_mib()  # read from a file, hence first
    renounce_privileges()
    if strongest is Confinement.kernel and landlock.version():
        landlock.restrict(devices=doors)
        names.append("landlock")
    if strongest is not Confinement.none:  # the driver of a GPU opens files and reserves many addresses
        _limit_resources(limits, inherited_mib, with_driver=bool(doors))
        names.append("rlimits")
    protect_memory()
    drop_capabilities()
    if strongest is Confinement.kernel and seccomp.is_available():
        seccomp.restrict(with_gpu=bool(doors))  # last, because the other measures need calls that it refuses
        names.append("seccomp")
    return (*names, *([_DOORS] if doors else []))


def _limit_resources(limits: Limits, inherited_mib: float, *, with_driver: bool) -> None:
    """Set the limits that the kernel enforces by process; as hard limits, which cannot be raised again.

    The driver of a GPU opens its device files again and again, and reserves more addresses than any memory has.
    """
    space = int((inherited_mib + limits.memory_mib + _SLACK_MIB) * 2**20)
    seconds = int(limits.seconds) + _CPU_SLACK
    without_driver = (
        (resource.RLIMIT_AS, space),
        (resource.RLIMIT_NOFILE, 0),  # what is open stays open; no file, socket or pipe can be added
    )
    for kind, value in (
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, 0),
        *(() if with_driver else without_driver),
    ):
        resource.setrlimit(kind, (value, value))
