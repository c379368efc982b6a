"""Promise: a filter lets the listed system calls of its own architecture through, and nothing else.

The filters are run here by a small machine of the tests' own, so that the one for the other architecture is tried
too; test_walls.py has the kernel run the one for this machine.
"""

import errno
import platform
import struct
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacevo.sandbox.devices import FRONTEND_COMMANDS, UVM_COMMANDS
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
            case 0x45:
                position += if_true if accumulator & operand else if_false
            case 0x54:
                accumulator &= operand
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


#: Calls that a driver's library may make, whose arguments the filter looks at: x86-64, aarch64.
IOCTL, FCNTL, CLONE, CLONE3, PRCTL = (16, 29), (72, 25), (56, 220), (435, 435), (157, 167)
#: No file, program, process, socket, ring, trace, shared memory, limit or namespace, but opening and threads.
STILL_DANGEROUS = {
    name: tuple(set(numbers) - {opening, CLONE[column], CLONE3[column]} - ({2} if name == "x86_64" else set()))
    for column, ((name, numbers), opening) in enumerate(zip(DANGEROUS.items(), (257, 56), strict=True))
}


def with_gpu(name: str, number: int, *arguments: int) -> int:
    """Run the filter of a candidate on a GPU."""
    text = program(MACHINES[name], PID, with_gpu=True)
    given = (*arguments, *(0,) * (6 - len(arguments)))
    return verdict(text, architecture=MACHINES[name].architecture, number=number, arguments=given)


@pytest.mark.parametrize("column", range(2))
@given(
    command=st.integers(0, 2**32 - 1) | st.integers(0, 100) | st.sampled_from([ord("F") << 8 | n for n in range(256)])
)
def test_driver_gets_its_commands_and_no_others(column: int, command: int) -> None:
    """Its own numbers with any size; no terminal's, no network's, and none that reads another's memory."""
    name = [*MACHINES][column]
    size = 0xC0300000  # read and written, 48 bytes
    known = command in UVM_COMMANDS or command & 0xFFFF in FRONTEND_COMMANDS
    assert with_gpu(name, IOCTL[column], 9, command) == (ALLOW if known else REFUSE)
    for own in (*UVM_COMMANDS, *FRONTEND_COMMANDS, *(size | number for number in FRONTEND_COMMANDS)):
        assert with_gpu(name, IOCTL[column], 9, own) == ALLOW
    for foreign in (0x5412, 0x8933, 0x5421, 62, 63, 56):  # TIOCSTI, SIOCGIFINDEX, FIONBIO, and tools of UVM
        assert with_gpu(name, IOCTL[column], 9, foreign) == REFUSE


@pytest.mark.parametrize("column", range(2))
def test_driver_starts_threads_and_no_processes(column: int) -> None:
    """By the flags of the call that a filter can see; of the other one it says that it does not exist."""
    name = [*MACHINES][column]
    thread, process = 0x3D0F00, 0x1200011  # as glibc makes a thread, and as it forks
    assert with_gpu(name, CLONE[column], thread) == ALLOW
    assert with_gpu(name, CLONE[column], process) == with_gpu(name, CLONE[column], 0x10000000) == REFUSE
    assert with_gpu(name, CLONE3[column], 0) == 0x00050000 | errno.ENOSYS
    assert with_gpu(name, PRCTL[column], 15) == ALLOW
    assert with_gpu(name, PRCTL[column], 4, 1) == with_gpu(name, PRCTL[column], 22, 2) == REFUSE


@pytest.mark.parametrize("column", range(2))
def test_files_of_a_driver_send_no_signals(column: int) -> None:
    """An open file can be told to signal another process when it is written to (F_SETOWN, F_SETSIG, O_ASYNC)."""
    name = [*MACHINES][column]
    assert {with_gpu(name, FCNTL[column], 9, command) for command in (0, 1, 2, 3, 1030)} == {ALLOW}
    assert {with_gpu(name, FCNTL[column], 9, command) for command in (4, 8, 10, 15, 1024, 1026)} == {REFUSE}


@EVERY_MACHINE
@given(number=NUMBERS | st.integers(0, 600))
def test_with_a_gpu_every_call_that_is_not_listed_is_refused(machine: Machine, number: int) -> None:
    """As without one, and what is dangerous stays refused by name."""
    name = next(each for each, known in MACHINES.items() if known == machine)
    listed = {*machine.allowed, *machine.with_gpu}
    by_argument = {machine.ioctl, machine.fcntl, machine.clone, machine.clone3, machine.prctl}
    if number not in by_argument:
        assert with_gpu(name, number, 7, 7) == (ALLOW if number in listed else REFUSE)
    for refused in STILL_DANGEROUS[name]:
        assert with_gpu(name, refused, 7, 7) == REFUSE


@EVERY_MACHINE
def test_filter_of_a_cpu_is_as_it_was(machine: Machine) -> None:
    """What a driver needs is in no filter of a candidate without a GPU."""
    text = program(machine, PID)
    assert text == program(replace(machine, with_gpu=(), ioctl=0, fcntl=0, clone=0, clone3=0, prctl=0), PID)


def test_filters_need_a_known_processor_and_a_kernel_that_has_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Elsewhere the numbers of the calls would mean others."""

    def refuse(*_: object) -> int:
        raise OSError(errno.ENOSYS, "Function not implemented")

    with monkeypatch.context() as kernel:
        kernel.setattr("tacevo.sandbox.seccomp.system_call", refuse)
        assert not is_available()
    monkeypatch.setattr(platform, "machine", lambda: "riscv64")
    assert not is_available()
