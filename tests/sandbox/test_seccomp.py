"""Promise: a filter lets the listed system calls of its own architecture through, and nothing else.

The filters are run here by a small machine of the tests' own, so that the one for the other architecture is tried
too; test_walls.py has the kernel run the one for this machine.
"""

import errno
import platform
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacevo.sandbox.seccomp import MACHINES, Machine, is_available, program

PID = 4321
ALLOW, REFUSE = 0x7FFF0000, 0x00050000 | errno.EPERM
NUMBERS = st.integers(0, 2**32 - 1)
EVERY_MACHINE = pytest.mark.parametrize("machine", MACHINES.values(), ids=MACHINES.keys())

#: Of each architecture, from the kernel's headers: open, start a program, a process, a socket, a ring, map a file to
#: another process, trace, make shared memory, lower limits, unshare, load a program into the kernel.
DANGEROUS = {
    "x86_64": (2, 257, 437, 59, 322, 56, 57, 58, 435, 41, 53, 425, 426, 310, 311, 101, 29, 30, 319, 160, 302, 272, 321),
    "aarch64": (56, 437, 221, 281, 220, 435, 198, 199, 425, 426, 270, 271, 117, 194, 196, 279, 164, 261, 97, 280),
}


def verdict(text: bytes, *, architecture: int, number: int, arguments: tuple[int, ...] = (0,) * 6) -> int:
    """Run a filter on one call, as the kernel does (seccomp(2), little-endian)."""
    data = struct.pack("<IIQ6Q", number, architecture, 0, *(value % 2**64 for value in arguments))
    code = list(struct.iter_unpack("<HBBI", text))
    accumulator = position = 0
    while True:
        operation, if_true, if_false, operand = code[position]
        position += 1
        match operation:
            case 0x20:
                (accumulator,) = struct.unpack_from("<I", data, operand)
            case 0x15:
                position += if_true if accumulator == operand else if_false
            case 0x06:
                return int(operand)
            case _:
                raise AssertionError(f"no operation of a filter: {operation:#x}")


@EVERY_MACHINE
@given(number=NUMBERS | st.integers(0, 600))
def test_every_other_call_is_refused(machine: Machine, number: int) -> None:
    """What computing needs is allowed; no other number slips through, those of x32 and of calls to come included."""
    text = program(machine, PID)
    for asked in (number, *machine.allowed):
        answer = verdict(text, architecture=machine.architecture, number=asked, arguments=(7,) * 6)
        assert answer == (ALLOW if asked in machine.allowed else REFUSE)


@EVERY_MACHINE
@given(architecture=NUMBERS)
def test_calls_of_another_architecture_are_refused(machine: Machine, architecture: int) -> None:
    """A program that switches to 32 bits, where the numbers mean other calls, gets nothing."""
    text = program(machine, PID)
    for number in machine.allowed:
        answer = verdict(text, architecture=architecture, number=number)
        assert answer == (ALLOW if architecture == machine.architecture else REFUSE)


@EVERY_MACHINE
@given(target=st.integers(-(2**31), 2**31 - 1))
def test_signals_reach_the_process_itself_only(machine: Machine, target: int) -> None:
    """Nobody else, no group and not everybody."""
    text = program(machine, PID)
    for number in machine.to_itself:
        answer = verdict(text, architecture=machine.architecture, number=number, arguments=(target, 9, 9, 0, 0, 0))
        assert answer == (ALLOW if target == PID else REFUSE)
        own = (PID, PID, 9, 0, 0, 0)
        assert verdict(text, architecture=machine.architecture, number=number, arguments=own) == ALLOW


@pytest.mark.parametrize("name", MACHINES)
def test_dangerous_calls_are_refused(name: str) -> None:
    """Files, programs, processes, sockets, rings, tracing, shared memory, limits: by their numbers in the headers."""
    machine = MACHINES[name]
    text = program(machine, PID)
    for number in DANGEROUS[name]:
        assert verdict(text, architecture=machine.architecture, number=number) == REFUSE


def test_filters_need_a_known_processor_and_a_kernel_that_has_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Elsewhere the numbers of the calls would mean others."""

    def refuse(*_: object) -> int:
        raise OSError(errno.ENOSYS, "Function not implemented")

    with monkeypatch.context() as kernel:
        kernel.setattr("tacevo.sandbox.seccomp.system_call", refuse)
        assert not is_available()
    monkeypatch.setattr(platform, "machine", lambda: "riscv64")
    assert not is_available()
