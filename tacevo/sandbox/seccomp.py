"""The seccomp filter: of some 350 system calls a candidate keeps only those that computing needs.

The list comes from watching trainings and probes of recorded answers with strace(1) after their start: they map
memory, wait for locks, write to the result pipe and end. The other listed calls are harmless: clocks, sleep, a
process's own signals. Every other call fails with EPERM: opening or inspecting files, sockets, programs, processes and
threads, io_uring, tracing, shared memory, namespaces, limits, and every call that a later kernel adds. The filter does
not look at the arguments of a call, except that a process may send signals only to itself.

With a GPU it lets more through, for the driver's library: opening (Landlock says what), closing and reading, events,
commands of the driver by number, threads but no processes, and what asks where memory lies. That list has not been seen
to suffice.

A filter is a program for a small machine inside the kernel (seccomp(2)), written here for x86-64 and aarch64.
"""

import ctypes
import errno
import os
import platform
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from tacevo.sandbox.devices import FRONTEND_COMMANDS, UVM_COMMANDS
from tacevo.sandbox.kernel import system_call

_INSTRUCTION = struct.Struct("=HBBI")  # operation, how far to jump if true, how far if false, operand
_LOAD_WORD, _JUMP_IF_EQUAL, _JUMP_IF_ANY_BIT, _KEEP_BITS, _RETURN = 0x20, 0x15, 0x45, 0x54, 0x06
#: The offsets at which the kernel puts the call's number, the architecture, and the low half of the first and the
#: second argument.
_NUMBER, _ARCHITECTURE, _FIRST_ARGUMENT, _SECOND_ARGUMENT = 0, 4, 16, 24
_ALLOW = 0x7FFF0000
_REFUSE = 0x00050000 | errno.EPERM
_UNKNOWN = 0x00050000 | errno.ENOSYS
_SET_FILTER, _IS_ACTION_AVAILABLE = 1, 2
# Otherwise kernels before 5.16 slow down all that a filtered process computes (speculative store bypass), to protect it
# from its own code.
_ALLOW_SPECULATION = 1 << 2
_ALL_THREADS = 1 << 0
_NEW_THREAD = 0x00010000  # CLONE_THREAD: of this process, with its memory and its walls
_NAME_OF_THREAD = 15  # PR_SET_NAME
#: The commands of fcntl(2) that are allowed: duplicate, read and set what exec closes, read flags. Others have the
#: kernel send signals to processes.
_FILE_COMMANDS = (0, 1, 2, 3, 1030)


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """The system calls of an architecture, by number."""

    #: The number by which the kernel's audit names it; a program may switch to another architecture's calls at any
    #: time.
    architecture: int
    seccomp: int
    #: The numbers of the calls in `_ALLOWED` and `_TO_ITSELF`.
    allowed: tuple[int, ...]
    to_itself: tuple[int, ...]
    #: The numbers of the calls in `_WITH_GPU`, by their names there.
    with_gpu: tuple[int, ...]
    ioctl: int
    fcntl: int
    clone: int
    clone3: int
    prctl: int


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

#: Calls that are allowed besides where the driver of a GPU needs them: files, events, where memory lies and what it is
#: made of, who this is, threads. x86-64 has older forms of some, which libraries still use; they stand twice elsewhere.
_WITH_GPU = {
    "openat": (257, 56),
    "open": (2, 56),
    "close": (3, 57),
    "read": (0, 63),
    "pread64": (17, 67),
    "lseek": (8, 62),
    "fstat": (5, 80),
    "stat": (4, 79),
    "newfstatat": (262, 79),
    "poll": (7, 73),
    "ppoll": (271, 73),
    "eventfd2": (290, 19),
    "mincore": (27, 232),
    "get_mempolicy": (239, 236),
    "mbind": (237, 235),
    "set_robust_list": (273, 99),
    "rseq": (334, 293),
    "uname": (63, 160),
    "sysinfo": (99, 179),
    "getuid": (102, 174),
    "geteuid": (107, 175),
    "getgid": (104, 176),
    "getegid": (108, 177),
}
#: Calls of the driver's library that are allowed with some arguments only.
_BY_ARGUMENT = {
    "ioctl": (16, 29),
    "fcntl": (72, 25),
    "clone": (56, 220),
    "clone3": (435, 435),
    "prctl": (157, 167),
}

MACHINES: Mapping[str, Machine] = {
    name: Machine(
        architecture=architecture,
        seccomp=seccomp,
        allowed=tuple(numbers[column] for numbers in _ALLOWED.values()),
        to_itself=tuple(numbers[column] for numbers in _TO_ITSELF.values()),
        with_gpu=tuple(dict.fromkeys(numbers[column] for numbers in _WITH_GPU.values())),
        **{name: numbers[column] for name, numbers in _BY_ARGUMENT.items()},
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


def program(machine: Machine, pid: int, *, with_gpu: bool = False) -> bytes:
    """Write the filter of one process, the only one that its signals may reach.

    The first test refuses calls of other architectures. Those of x32 have numbers that are not listed.
    """
    allowed = (*machine.allowed, *(machine.with_gpu if with_gpu else ()))
    text = [
        _INSTRUCTION.pack(_LOAD_WORD, 0, 0, _ARCHITECTURE),
        _INSTRUCTION.pack(_JUMP_IF_EQUAL, 1, 0, machine.architecture),
        _INSTRUCTION.pack(_RETURN, 0, 0, _REFUSE),
        _INSTRUCTION.pack(_LOAD_WORD, 0, 0, _NUMBER),
    ]
    for number in allowed:
        text += [_INSTRUCTION.pack(_JUMP_IF_EQUAL, 0, 1, number), _INSTRUCTION.pack(_RETURN, 0, 0, _ALLOW)]
    for number in machine.to_itself:
        text += [
            _INSTRUCTION.pack(_JUMP_IF_EQUAL, 0, 4, number),
            _INSTRUCTION.pack(_LOAD_WORD, 0, 0, _FIRST_ARGUMENT),
            _INSTRUCTION.pack(_JUMP_IF_EQUAL, 0, 1, pid),
            _INSTRUCTION.pack(_RETURN, 0, 0, _ALLOW),
            _INSTRUCTION.pack(_RETURN, 0, 0, _REFUSE),
        ]
    if with_gpu:
        text += _driver_calls(machine)
    return b"".join([*text, _INSTRUCTION.pack(_RETURN, 0, 0, _REFUSE)])


def _driver_calls(machine: Machine) -> list[bytes]:
    """Write the part of a filter that looks at arguments of the driver's calls; the call's number is loaded."""
    allow, refuse = (_INSTRUCTION.pack(_RETURN, 0, 0, answer) for answer in (_ALLOW, _REFUSE))

    def any_of(numbers: Iterable[int]) -> list[bytes]:
        return [part for number in numbers for part in (_INSTRUCTION.pack(_JUMP_IF_EQUAL, 0, 1, number), allow)]

    second = _INSTRUCTION.pack(_LOAD_WORD, 0, 0, _SECOND_ARGUMENT)
    without_size = _INSTRUCTION.pack(_KEEP_BITS, 0, 0, 0xFFFF)
    first = _INSTRUCTION.pack(_LOAD_WORD, 0, 0, _FIRST_ARGUMENT)
    parts = {
        machine.ioctl: [second, *any_of(UVM_COMMANDS), without_size, *any_of(FRONTEND_COMMANDS), refuse],
        machine.fcntl: [second, *any_of(_FILE_COMMANDS), refuse],
        machine.clone: [first, _INSTRUCTION.pack(_JUMP_IF_ANY_BIT, 0, 1, _NEW_THREAD), allow, refuse],
        # A filter cannot see its flags, which lie in memory. Told that there is no such call, libraries use the other.
        machine.clone3: [_INSTRUCTION.pack(_RETURN, 0, 0, _UNKNOWN)],
        machine.prctl: [first, *any_of([_NAME_OF_THREAD]), refuse],
    }
    text = []
    for number, part in parts.items():
        text += [_INSTRUCTION.pack(_JUMP_IF_EQUAL, 0, len(part), number), *part]
    return text


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("text", ctypes.c_char_p))


def restrict(*, with_gpu: bool = False) -> None:
    """Take from this process every call that is not listed, for good.

    It must have one thread; with a GPU it has those of the driver, too, which are restricted alike.

    Raises:
        OSError: the kernel does not accept filters, `no_new_privs` is not set, or a thread has a filter of its own.
    """
    machine = MACHINES[platform.machine()]
    text = program(machine, os.getpid(), with_gpu=with_gpu)
    filter_ = _Program(len(text) // _INSTRUCTION.size, text)
    flags = _ALLOW_SPECULATION | (_ALL_THREADS if with_gpu else 0)
    if system_call(machine.seccomp, _SET_FILTER, flags, ctypes.byref(filter_)) != 0:
        raise OSError(errno.EBUSY, "a thread of this process has a filter of its own")
