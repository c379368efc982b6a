"""The seccomp filter: of some 350 system calls a candidate keeps only those that computing needs.

The list comes from watching trainings and probes of recorded answers with strace(1) after their start: they map
memory, wait for locks, write to the result pipe and end. The other listed calls are harmless: clocks, sleep, a
process's own signals. Every other call fails with EPERM: opening or inspecting files, sockets, programs, processes and
threads, io_uring, tracing, shared memory, namespaces, limits, and every call that a later kernel adds. The filter does
not look at the arguments of a call, except that a process may send signals only to itself.

A filter is a program for a small machine inside the kernel (seccomp(2)), written here for x86-64 and aarch64.
"""

import ctypes
import errno
import os
import platform
import struct
from collections.abc import Mapping
from dataclasses import dataclass

from tacevo.sandbox.kernel import system_call

_INSTRUCTION = struct.Struct("=HBBI")  # operation, how far to jump if true, how far if false, operand
_LOAD_WORD, _JUMP_IF_EQUAL, _RETURN = 0x20, 0x15, 0x06
#: Where the kernel puts the call's number, the architecture, and the low half of the first argument.
_NUMBER, _ARCHITECTURE, _FIRST_ARGUMENT = 0, 4, 16
_ALLOW = 0x7FFF0000
_REFUSE = 0x00050000 | errno.EPERM
_SET_FILTER, _IS_ACTION_AVAILABLE = 1, 2
# Otherwise kernels before 5.16 slow down all that a filtered process computes (speculative store bypass), to protect it
# from its own code.
_ALLOW_SPECULATION = 1 << 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """The system calls of an architecture, by number."""

    #: As the kernel's audit names it; a program may switch to another architecture's calls at any time.
    architecture: int
    seccomp: int
    #: As in `_ALLOWED` and `_TO_ITSELF`.
    allowed: tuple[int, ...]
    to_itself: tuple[int, ...]


#: The system calls that are allowed, by their numbers on x86-64 and aarch64.
_ALLOWED = {
    "brk": (12, 214),
    "mmap": (9, 222),
    "mprotect": (10, 226),
    "mremap": (25, 216),
    "munmap": (11, 215),
    "madvise": (28, 233),
    "futex": (202, 98),
    "write": (1, 64),
    "getrandom": (318, 278),
    "clock_gettime": (228, 113),
    "clock_getres": (229, 114),
    "clock_nanosleep": (230, 115),
    "gettimeofday": (96, 169),
    "nanosleep": (35, 101),
    "restart_syscall": (219, 128),
    "sched_yield": (24, 124),
    "sched_getaffinity": (204, 123),
    "getrusage": (98, 165),
    "getpid": (39, 172),
    "getppid": (110, 173),
    "gettid": (186, 178),
    "rt_sigaction": (13, 134),
    "rt_sigprocmask": (14, 135),
    "rt_sigreturn": (15, 139),
    "sigaltstack": (131, 132),
    "exit": (60, 93),
    "exit_group": (231, 94),
}

#: Calls that send a signal, allowed where the first argument is the process itself.
_TO_ITSELF = {"kill": (62, 129), "tgkill": (234, 131)}

MACHINES: Mapping[str, Machine] = {
    name: Machine(
        architecture=architecture,
        seccomp=seccomp,
        allowed=tuple(numbers[column] for numbers in _ALLOWED.values()),
        to_itself=tuple(numbers[column] for numbers in _TO_ITSELF.values()),
    )
    for column, (name, architecture, seccomp) in enumerate((("x86_64", 0xC000003E, 317), ("aarch64", 0xC00000B7, 277)))
}


def is_available() -> bool:
    """Return whether the kernel accepts filters and this module knows the architecture."""
    if (machine := MACHINES.get(platform.machine())) is None:
        return False
    try:
        system_call(machine.seccomp, _IS_ACTION_AVAILABLE, 0, ctypes.byref(ctypes.c_uint32(_REFUSE & 0xFFFF0000)))
    except OSError:
        return False
    return True


def program(machine: Machine, pid: int) -> bytes:
    """Write the filter of one process, the only one that its signals may reach.

    The first test refuses calls of other architectures. Those of x32 have numbers that are not listed.
    """
    text = [
        _INSTRUCTION.pack(_LOAD_WORD, 0, 0, _ARCHITECTURE),
        _INSTRUCTION.pack(_JUMP_IF_EQUAL, 1, 0, machine.architecture),
        _INSTRUCTION.pack(_RETURN, 0, 0, _REFUSE),
        _INSTRUCTION.pack(_LOAD_WORD, 0, 0, _NUMBER),
    ]
    for number in machine.allowed:
        text += [_INSTRUCTION.pack(_JUMP_IF_EQUAL, 0, 1, number), _INSTRUCTION.pack(_RETURN, 0, 0, _ALLOW)]
    for number in machine.to_itself:
        text += [
            _INSTRUCTION.pack(_JUMP_IF_EQUAL, 0, 4, number),
            _INSTRUCTION.pack(_LOAD_WORD, 0, 0, _FIRST_ARGUMENT),
            _INSTRUCTION.pack(_JUMP_IF_EQUAL, 0, 1, pid),
            _INSTRUCTION.pack(_RETURN, 0, 0, _ALLOW),
            _INSTRUCTION.pack(_RETURN, 0, 0, _REFUSE),
        ]
    return b"".join([*text, _INSTRUCTION.pack(_RETURN, 0, 0, _REFUSE)])


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("text", ctypes.c_char_p))


def restrict() -> None:
    """Take from this process, which must have one thread, every call that is not listed, for good.

    Raises:
        OSError: the kernel does not accept filters, or `no_new_privs` is not set.
    """
    machine = MACHINES[platform.machine()]
    text = program(machine, os.getpid())
    filter_ = _Program(len(text) // _INSTRUCTION.size, text)
    system_call(machine.seccomp, _SET_FILTER, _ALLOW_SPECULATION, ctypes.byref(filter_))
