"""The seccomp filter: of some 350 system calls a candidate keeps those that computing needs, and no other.

The list was found by watching trainings and probes of recorded answers with strace(1) after their start: they map
memory, wait for locks, write to the result pipe and end. The rest of it is harmless: clocks, sleep, a process's own
signals. Whatever is not listed answers EPERM: to open or look at a file, sockets, programs, processes and threads,
io_uring, tracing, shared memory, namespaces, limits, and every call that a later kernel adds. The arguments of a
call do not matter, except that a signal may go to the process itself only.

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

# Kernels before 5.16 would else slow down all that a filtered process computes (speculative store bypass), to
# protect it from its own code.
_ALLOW_SPECULATION = 1 << 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """The system calls of an architecture, by number."""

    #: As the kernel's audit names it; a program may switch to another architecture's calls at any time.
    architecture: int
    seccomp: int
    allowed: Mapping[str, int]
    #: Calls that send a signal, allowed where the first argument is the process itself.
    to_itself: Mapping[str, int]


MACHINES: Mapping[str, Machine] = {
    "x86_64": Machine(
        architecture=0xC000003E,
        seccomp=317,
        allowed={
            "brk": 12,
            "mmap": 9,
            "mprotect": 10,
            "mremap": 25,
            "munmap": 11,
            "madvise": 28,
            "futex": 202,
            "write": 1,
            "getrandom": 318,
            "clock_gettime": 228,
            "clock_getres": 229,
            "clock_nanosleep": 230,
            "gettimeofday": 96,
            "nanosleep": 35,
            "restart_syscall": 219,
            "sched_yield": 24,
            "sched_getaffinity": 204,
            "getrusage": 98,
            "getpid": 39,
            "getppid": 110,
            "gettid": 186,
            "rt_sigaction": 13,
            "rt_sigprocmask": 14,
            "rt_sigreturn": 15,
            "sigaltstack": 131,
            "exit": 60,
            "exit_group": 231,
        },
        to_itself={"kill": 62, "tgkill": 234},
    ),
    "aarch64": Machine(
        architecture=0xC00000B7,
        seccomp=277,
        allowed={
            "brk": 214,
            "mmap": 222,
            "mprotect": 226,
            "mremap": 216,
            "munmap": 215,
            "madvise": 233,
            "futex": 98,
            "write": 64,
            "getrandom": 278,
            "clock_gettime": 113,
            "clock_getres": 114,
            "clock_nanosleep": 115,
            "gettimeofday": 169,
            "nanosleep": 101,
            "restart_syscall": 128,
            "sched_yield": 124,
            "sched_getaffinity": 123,
            "getrusage": 165,
            "getpid": 172,
            "getppid": 173,
            "gettid": 178,
            "rt_sigaction": 134,
            "rt_sigprocmask": 135,
            "rt_sigreturn": 139,
            "sigaltstack": 132,
            "exit": 93,
            "exit_group": 94,
        },
        to_itself={"kill": 129, "tgkill": 131},
    ),
}


def is_available() -> bool:
    """Tell whether the kernel takes filters, and this module knows the architecture."""
    machine = MACHINES.get(platform.machine())
    if machine is None:
        return False
    try:
        system_call(machine.seccomp, _IS_ACTION_AVAILABLE, 0, ctypes.byref(ctypes.c_uint32(_REFUSE & 0xFFFF0000)))
    except OSError:
        return False
    return True


def program(machine: Machine, pid: int) -> bytes:
    """Write the filter of one process.

    Calls of other architectures are refused by the first test; those of x32 by their numbers, which are in no list.

    Args:
        machine: the system calls of the architecture.
        pid: the process that signals may reach.
    """
    text = [
        _INSTRUCTION.pack(_LOAD_WORD, 0, 0, _ARCHITECTURE),
        _INSTRUCTION.pack(_JUMP_IF_EQUAL, 1, 0, machine.architecture),
        _INSTRUCTION.pack(_RETURN, 0, 0, _REFUSE),
        _INSTRUCTION.pack(_LOAD_WORD, 0, 0, _NUMBER),
    ]
    for number in machine.allowed.values():
        text += [_INSTRUCTION.pack(_JUMP_IF_EQUAL, 0, 1, number), _INSTRUCTION.pack(_RETURN, 0, 0, _ALLOW)]
    for number in machine.to_itself.values():
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
    """Refuse this process, which must have one thread, every call that is not listed, for good.

    Raises:
        OSError: the kernel takes no filter, or `no_new_privs` is not set.
    """
    machine = MACHINES[platform.machine()]
    text = program(machine, os.getpid())
    filter_ = _Program(len(text) // _INSTRUCTION.size, text)
    system_call(machine.seccomp, _SET_FILTER, _ALLOW_SPECULATION, ctypes.byref(filter_))
