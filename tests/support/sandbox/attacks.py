"""Entries that do to the sandbox what a hostile candidate would; imported by the zygote, so without pytest."""

import atexit
import contextlib
import ctypes
import importlib
import mmap
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from array import array
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from tacevo.sandbox.child import Arrays, Send

MIB = 2**20
_PTRACE_TRACEME = 0
_DONE = struct.pack("!BIQ", 6, 4, 0) + b"null"  # the message that the entry returned
_EXIT = {"x86_64": 60, "aarch64": 93}[os.uname().machine]  # the system call that ends one thread


def echo(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Answer with what came."""
    send(header, payload)


def hear(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Send payloads, then what was said of each."""
    said = [send(None, part.encode()) for part in header]
    send(said, b"end")


def send_without_waiting(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Write many frames, and ask about none."""
    _write_all(b"".join([_frame(4)] * 500) + _DONE)


def send_after_the_end(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Write two frames, the end, and two frames more."""
    _write_all(b"".join([_frame(4)] * 2) + _DONE + b"".join([_frame(4)] * 2))


def spin_while_scored(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Write two frames and compute on, whatever is said of them."""
    _write_all(_frame(4) * 2)
    spin(header, payload, arrays, send)


def lose_children_while_scored(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Let a child compute before each frame, and kill it while the frame is scored: nobody waits for it."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    done = mmap.mmap(-1, 50)
    for number in range(50):
        child = os.fork()
        if child == 0:
            while time.process_time() < 0.3:
                pass
            done[number] = 1
            signal.pause()
        while not done[number]:
            time.sleep(0.01)
        threading.Timer(0.05, os.kill, (child, signal.SIGKILL)).start()
        send({}, b"1")


def fill_memory_while_scored(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Write a frame that no socket's buffer holds, then take 600 MiB."""
    _write_all(_frame(2**20 // 4))
    fill_shared_memory(header, payload, arrays, send)


def send_better_and_better(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Predict numbers that come nearer to all labels, each time after the same epoch; send what was said of each."""
    values = header["validation"] * header["contract"]["outputs"]
    report = {"epoch": 0, "train_loss": 0.5, "steps": 8}
    guesses = (array("f", [100.0 - number] * values).tobytes() for number in range(50))
    send([send(report, guess) for guess in guesses], b"")


def look_around(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Report what a candidate can see of its own process."""
    send(
        {
            "environment": dict(os.environ),
            "directory": os.getcwd(),
            "is_session_leader": os.getsid(0) == os.getpid(),
            "descriptors": sum(_works(partial(os.fstat, number)) for number in range(1024)),
            "streams": [os.readlink(f"/proc/self/fd/{n}") for n in range(3)],
            "hash": hash("seed"),
        },
        b"",
    )


def sum_images(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Read the shared images, then try to change them."""
    total = int(arrays["images"].sum())
    try:
        arrays["images"][0] = 0
    except ValueError:
        send(total, b"")


def spin(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Never return, deaf to every signal that can be ignored."""
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGALRM, signal.SIGXCPU):
        signal.signal(number, signal.SIG_IGN)
    while True:
        pass


def spin_with_family(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Never return, in five processes, three of which left the session."""
    for number in range(4):
        if os.fork() == 0:
            if number:
                os.setsid()
                if os.fork():
                    os._exit(0)
            _sleep_for_ever()
    _sleep_for_ever()


def leave_an_orphan(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Answer at once with the process id of a grandchild that left the session and goes on."""
    shared = mmap.mmap(-1, 4)
    if os.fork() == 0:
        os.setsid()
        if os.fork() == 0:
            shared[:] = struct.pack("!I", os.getpid())
            _sleep_for_ever()
        os._exit(0)
    while not any(shared[:]):
        time.sleep(0.001)
    send(struct.unpack("!I", shared[:])[0], b"")


class _Endless:
    def __del__(self) -> None:
        while True:
            pass


def spin_in_finaliser(header: Any, payload: bytes, arrays: Arrays, send: Send) -> object:
    """Answer, and give back an object whose finaliser never ends."""
    send("answered", b"")
    return _Endless()


def spin_at_exit(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Answer, and register an exit handler that never ends."""
    atexit.register(_sleep_for_ever)
    send("answered", b"")


def doze(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Make it seen from outside that the job runs, by a lower priority, then answer after half a second."""
    os.nice(1)
    time.sleep(0.5)
    send("answered", b"")


def kill_itself(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Die as if the kernel had run out of memory."""
    os.kill(os.getpid(), signal.SIGKILL)


def exit_quietly(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """End the process as if all were well, before answering."""
    os._exit(0)


def raise_system_exit(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Raise what `except Exception` does not catch."""
    raise SystemExit(0)


def divide_by_zero(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Raise an ordinary exception."""
    print(1 / 0)


def read_address_zero(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Crash in native code."""
    ctypes.string_at(0)


def print_much(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Print 50 MB to both streams, then answer."""
    for _ in range(50):
        print("x" * MIB)
        print("x" * MIB, file=sys.stderr)
    send("answered", b"")


def reserve_two_gib(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Ask for 2 GiB in one piece."""
    send(len(bytearray(2048 * MIB)), b"")


def fill_shared_memory(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Fill 600 MiB of anonymous shared memory, all in one call, however busy the machine is."""
    _kept = mmap.mmap(-1, 600 * MIB, flags=mmap.MAP_SHARED | mmap.MAP_ANONYMOUS | mmap.MAP_POPULATE)
    _sleep_for_ever()


def flash_memory(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Hold 48 MiB for an instant, as the very last thing before the end."""
    mmap.mmap(-1, 48 * MIB, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | mmap.MAP_POPULATE).close()


def fill_memory_in_family(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Take four times 100 MiB, each in a process of its own."""
    for _ in range(4):
        if os.fork() == 0:
            _kept = b"x" * (100 * MIB)
            _sleep_for_ever()
    _sleep_for_ever()


def fill_memory_without_leader(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Take 400 MiB in a process whose first thread has ended."""
    threading.Thread(target=_fill_memory_soon).start()
    _end_this_thread()


def fill_memory_in_fork_without_leader(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Take 400 MiB in a child whose first thread has ended."""
    if os.fork() == 0:
        fill_memory_without_leader(header, payload, arrays, send)
    _sleep_for_ever()


def close_pipe_without_leader(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Close the result pipe in a process whose first thread has ended, and go on."""
    threading.Thread(target=_close_pipe_soon).start()
    _end_this_thread()


def close_pipe_while_traced(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Make the supervisor a tracer that is told of stops, stop, and close the result pipe in another thread."""
    threading.Thread(target=_close_pipe_soon).start()
    libc = ctypes.CDLL(None)
    libc.ptrace(_PTRACE_TRACEME, 0, 0, 0)
    libc["raise"](signal.SIGUSR1)  # without the interpreter's lock, so that the other thread goes on


def kill_supervisor(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Kill the parent, and stay behind with a child."""
    supervisor = os.getppid()
    os.fork()
    os.kill(supervisor, signal.SIGKILL)
    _sleep_for_ever()


def stop_supervisor(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Stop the parent, so that nobody watches the limits."""
    os.kill(os.getppid(), signal.SIGSTOP)
    _sleep_for_ever()


def kill_zygote(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Kill the parent's parent, whose process id it was told, then answer."""
    os.kill(header, signal.SIGKILL)
    time.sleep(0.2)
    send("answered", b"")


def kill_supervisor_and_zygote(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Kill the parent and, before it, the parent's parent, which leads the process group."""
    supervisor = os.getppid()
    os.kill(os.getpgid(supervisor), signal.SIGKILL)
    os.kill(supervisor, signal.SIGKILL)
    _sleep_for_ever()


def write_raw(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Write the payload, as it is, into the result pipe."""
    os.write(_pipe(), payload)
    _sleep_for_ever()


def announce_lists(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Write a header of 20 million empty lists, 60 MiB that would take 1.3 GiB when parsed, and end well."""
    _write_all(_frame(20 * MIB) + _DONE)


def send_lists_that_fit(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Write a header of empty lists that is as long as a header may be, and end well."""
    _write_all(_frame(699_000) + _DONE)


def send_crumbs(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Write 4.7 million tiny frames, 63 MiB, and end well."""
    _write_all(struct.pack("!BIQ", 5, 1, 0) + b"0", times=4_700_000)
    _write_all(_DONE)


def raise_at_length(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Write that the entry raised something whose text has 60 MiB, none of it legible."""
    _write_all(struct.pack("!BIQ", 7, 4, 60 * MIB) + b"null" + b"\xff" * (60 * MIB))
    _sleep_for_ever()


def close_pipe(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Close the result pipe and go on."""
    os.close(_pipe())
    _sleep_for_ever()


def answer_much(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Send 100 MiB."""
    for number in range(100):
        send(number, bytes(MIB))


def steal(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Try to read memory and environment of supervisor, zygote and search; report what worked."""
    taken = []
    for pid in (os.getppid(), header["search"]):
        for name in ("environ", "mem", "maps"):
            if _works(partial(os.open, f"/proc/{pid}/{name}", os.O_RDONLY)):
                taken.append(f"{pid} {name}")
        attach = 16
        if ctypes.CDLL(None, use_errno=True).ptrace(attach, pid, 0, 0) == 0:
            taken.append(f"{pid} ptrace")
    send(taken, b"")


def open_things(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Try to open a file to read, a socket, a pipe, a file in memory, and to start a program; report what worked."""
    attempts: dict[str, Callable[[], object]] = {
        "file": partial(os.open, "/etc/hostname", os.O_RDONLY),
        "tcp": partial(socket.socket, socket.AF_INET),
        "unix": partial(socket.socket, socket.AF_UNIX),
        "pipe": os.pipe,
        "memory": partial(os.memfd_create, "x"),
        "program": partial(subprocess.run, ["/bin/true"], check=False),
    }
    send([name for name, attempt in attempts.items() if _works(attempt)], b"")


def write_files(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Try to write a byte: to a new file, to an old one, and by growing one."""
    folder = Path(header["folder"])
    _works(lambda: (folder / "new").write_text("x"))
    _works(lambda: (folder / "old").write_text("x"))
    _works(lambda: os.truncate(folder / "old", MIB))
    send("tried", b"")


def _works(act: Callable[[], Any]) -> bool:
    try:
        act()
    except OSError:
        return False
    return True


def _pipe() -> int:
    """Find the result pipe: the only file beside the standard streams."""
    return next(n for n in range(3, 64) if _works(partial(os.fstat, n)))


def _frame(lists: int) -> bytes:
    """Write a frame whose header is a list of empty lists."""
    text = b"[" + b"[]," * lists + b"0]"
    return struct.pack("!BIQ", 5, len(text), 0) + text


def _write_all(data: bytes, times: int = 1) -> None:
    """Write bytes into the result pipe, again and again."""
    pipe, left = _pipe(), memoryview(data * times)
    while left:
        left = left[os.write(pipe, left) :]


def _fill_memory_soon() -> None:
    time.sleep(0.2)  # until the first thread has ended
    _kept = b"x" * (400 * MIB)
    _sleep_for_ever()


def _close_pipe_soon() -> None:
    time.sleep(0.2)  # until the first thread has ended, or stopped
    os.close(_pipe())
    _sleep_for_ever()


def _end_this_thread() -> None:
    """End a thread without Python's knowledge; the call gave the interpreter's lock back, so that others go on."""
    ctypes.CDLL(None).syscall(_EXIT, 0)


def _sleep_for_ever() -> None:
    while True:
        time.sleep(60)


def import_modules(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Send a frame, then try to import modules; report those that were there before, and those that are now."""
    send("begun", b"")
    before = [name for name in header if name in sys.modules]
    for name in header:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    send([before, [name for name in header if name in sys.modules]], b"")
