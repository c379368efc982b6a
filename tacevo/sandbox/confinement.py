"""What holds a candidate inside its process, and what this machine can offer of it.

In force today are measures that need no special kernel ("process"). The kernel's own walls (Landlock, seccomp)
have their place in `confine` and come with a later issue; until then `require` refuses a run that asks for them.
See docs/security.md for what follows from each measure, and what does not.
"""

import ctypes
import os
import resource

from tacevo.choices import Confinement
from tacevo.errors import SandboxError
from tacevo.records import Limits
from tacevo.sandbox.processes import address_space_mib

#: Address space beyond the zygote's and the memory limit that allocators reserve without using it, in MiB.
_SLACK_MIB = 1024
#: CPU seconds beyond the wall-time limit; a backstop for a supervisor that is stopped.
_CPU_SLACK = 10

_PR_SET_DUMPABLE = 4
_PR_SET_CHILD_SUBREAPER = 36
_PR_SET_NO_NEW_PRIVS = 38
_ADDR_NO_RANDOMIZE = 0x0040000
_READ_PERSONALITY = 0xFFFFFFFF
_CAPABILITY_VERSION_3 = 0x20080522


def available() -> Confinement:
    """Say the strongest level that this version applies on this machine."""
    linux = hasattr(os, "pidfd_open") and os.path.exists("/proc/thread-self/children")
    return Confinement.process if linux else Confinement.none


def require(level: Confinement) -> None:
    """Refuse to go on where candidates cannot be confined as strongly as asked.

    Raises:
        SandboxError: the level is not available.
    """
    levels = list(Confinement)
    if levels.index(level) > levels.index(available()):
        raise SandboxError(
            f"sandbox.require={level} is not available here; the strongest level is {available()!s}. "
            "Kernel confinement (Landlock, seccomp) is not part of this version; use sandbox.require=process"
        )


def report() -> dict[str, str]:
    """Describe every measure in a line, for `tacevo doctor`: name to what it does, or why it is missing."""
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
        "landlock": "not in this version",
        "seccomp": "not in this version",
    }


def confine(limits: Limits) -> tuple[str, ...]:
    """Give up, for good, what this process does not need as a candidate; called in the child, before its source.

    Args:
        limits: what the candidate may use.

    Returns:
        The names of the measures in force, as `report` spells them.

    Raises:
        OSError: the kernel refused a measure.
    """
    _limit_resources(limits)
    _control(_PR_SET_NO_NEW_PRIVS, 1)
    protect_memory()
    _drop_capabilities()
    # Kernel confinement goes here: a Landlock ruleset, then a seccomp filter, each adding its name.
    return ("rlimits", "no_new_privs", "not_dumpable", "no_capabilities")


def protect_memory() -> None:
    """Let no unprivileged process trace this one or read its memory, environment or descriptors."""
    _control(_PR_SET_DUMPABLE, 0)


def become_subreaper() -> None:
    """Make this process the parent of every orphan below it, so that none escapes its sight."""
    _control(_PR_SET_CHILD_SUBREAPER, 1)


def fix_addresses() -> bool:
    """Switch the randomisation of addresses off for whatever program this thread starts next.

    Sets of classes iterate in the order of their addresses, which would else differ from run to run.

    Returns:
        False where the kernel, or a container's filter, refuses.
    """
    kernel = ctypes.CDLL(None)
    current: int = kernel.personality(ctypes.c_ulong(_READ_PERSONALITY))
    return bool(current != -1 and kernel.personality(ctypes.c_ulong(current | _ADDR_NO_RANDOMIZE)) != -1)


def can_fix_addresses() -> bool:
    """Tell whether `fix_addresses` works here, and leave this thread as it was."""
    kernel = ctypes.CDLL(None)
    current = kernel.personality(ctypes.c_ulong(_READ_PERSONALITY))
    granted = fix_addresses()
    if granted:
        kernel.personality(ctypes.c_ulong(current))
    return granted


def _limit_resources(limits: Limits) -> None:
    """Set the limits that the kernel keeps for each process by itself; hard limits, so they cannot be raised."""
    space = int((address_space_mib() + limits.memory_mib + _SLACK_MIB) * 2**20)
    seconds = int(limits.seconds) + _CPU_SLACK
    for kind, value in (
        (resource.RLIMIT_AS, space),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_NOFILE, 0),  # what is open stays open; no file, socket or pipe can be added
    ):
        resource.setrlimit(kind, (value, value))


class _CapabilityHeader(ctypes.Structure):
    _fields_ = (("version", ctypes.c_uint32), ("pid", ctypes.c_int))


class _CapabilitySets(ctypes.Structure):
    """Effective, permitted and inheritable sets; two of these make 64 bits each."""

    _fields_ = (("effective", ctypes.c_uint32), ("permitted", ctypes.c_uint32), ("inheritable", ctypes.c_uint32))


def _drop_capabilities() -> None:
    """Empty this process's capability sets, so that a candidate run by root cannot trace its parents."""
    header = _CapabilityHeader(_CAPABILITY_VERSION_3, 0)
    _checked(ctypes.CDLL(None, use_errno=True).capset(ctypes.byref(header), (_CapabilitySets * 2)()), "capset")


def _control(option: int, value: int) -> None:
    """Set one attribute of this process with prctl(2)."""
    _checked(ctypes.CDLL(None, use_errno=True).prctl(option, value, 0, 0, 0), f"prctl({option})")


def _checked(status: int, call: str) -> None:
    if status != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"{call}: {os.strerror(number)}")
