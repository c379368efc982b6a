"""System calls that Python has no function for; each raises `OSError` where the kernel refuses."""

import contextlib
import ctypes
import os
import signal
import struct
from pathlib import Path

#: Attributes of a process, for prctl(2).
_PR_SET_PDEATHSIG = 1
_PR_SET_DUMPABLE = 4
_PR_SET_CHILD_SUBREAPER = 36
_PR_SET_NO_NEW_PRIVS = 38
_ADDR_NO_RANDOMIZE = 0x0040000
_READ_PERSONALITY = 0xFFFFFFFF
_CAPABILITY_VERSION_3 = 0x20080522


def system_call(number: int, *arguments: int | object) -> int:
    """Make a system call by its number on this architecture, with integers and what `ctypes` passes as a pointer.

    Raises:
        OSError: the kernel refused, or does not know the call.
    """
    call = ctypes.CDLL(None, use_errno=True).syscall
    call.restype = ctypes.c_long
    words = [ctypes.c_long(value) if isinstance(value, int) else value for value in arguments]
    answer: int = call(ctypes.c_long(number), *words)
    return _checked(answer, f"system call {number}")


def protect_memory() -> None:
    """Keep unprivileged processes from tracing this one or reading its memory, environment or descriptors."""
    _control(_PR_SET_DUMPABLE, 0)


def end_with(parent: int) -> None:
    """Have the kernel kill this process as soon as its parent, which may be gone already, is gone for any reason."""
    _control(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def lower_priority(nice: int) -> None:
    """Let other work go first: this process, and those that it starts, have at least this niceness, 1 to 19."""
    os.setpriority(os.PRIO_PROCESS, 0, max(nice, os.getpriority(os.PRIO_PROCESS, 0)))


def keep_priority() -> None:
    """Give a session that this process has for itself the process's niceness, where it lets others go first.

    Where Linux groups processes by session, niceness counts within a group only. Nothing happens where the kernel does
    not group so, or refuses.
    """
    if (nice := os.getpriority(os.PRIO_PROCESS, 0)) > 0:
        with contextlib.suppress(OSError):
            Path("/proc/self/autogroup").write_text(str(nice))


def become_subreaper() -> None:
    """Make this process the parent of every orphan below it, so that it sees all of them."""
    _control(_PR_SET_CHILD_SUBREAPER, 1)


def renounce_privileges() -> None:
    """Keep the programs that this process starts from gaining privileges, from now on."""
    _control(_PR_SET_NO_NEW_PRIVS, 1)


def fix_addresses() -> bool:
    """Switch the randomisation of addresses off for the program that this thread starts next.

    Sets of classes iterate in the order of their addresses, which would otherwise differ from run to run. Return False
    where the kernel refuses, or the filter of a container.
    """
    kernel = ctypes.CDLL(None)
    current: int = kernel.personality(ctypes.c_ulong(_READ_PERSONALITY))
    return bool(current != -1 and kernel.personality(ctypes.c_ulong(current | _ADDR_NO_RANDOMIZE)) != -1)


def can_fix_addresses() -> bool:
    """Return whether `fix_addresses` works here, and leave this thread as it was."""
    kernel = ctypes.CDLL(None)
    current = kernel.personality(ctypes.c_ulong(_READ_PERSONALITY))
    granted = fix_addresses()
    if granted:
        kernel.personality(ctypes.c_ulong(current))
    return granted


def drop_capabilities() -> None:
    """Empty this process's capability sets, so that a candidate run by root cannot trace its parents."""
    header = struct.pack("=Ii", _CAPABILITY_VERSION_3, 0)  # 0 is this process
    none_of_64 = bytes(2 * 12)  # effective, permitted and inheritable sets, each in two words
    _checked(ctypes.CDLL(None, use_errno=True).capset(header, none_of_64), "capset")


def _control(option: int, value: int) -> None:
    """Set one attribute of this process."""
    _checked(ctypes.CDLL(None, use_errno=True).prctl(option, value, 0, 0, 0), f"prctl({option})")


def _checked(status: int, call: str) -> int:
    if status == -1:
        number = ctypes.get_errno()
        raise OSError(number, f"{call}: {os.strerror(number)}")
    return status
