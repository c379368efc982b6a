"""Entries that try what the kernel's walls forbid; imported by the zygote, so without pytest.

Each attempt tells the error that the kernel gave, or `worked`; a tests that sees it work without the walls knows that
it is a real one.
"""

import ctypes
import errno
import mmap
import os
import resource
import signal
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from tacevo.sandbox.child import Arrays, Send
from tacevo.sandbox.seccomp import MACHINES

#: Bytes of shared memory, and the key under which it would be found again.
_SHARED_BYTES = 4096
_IPC_CREATE = 0o1000 | 0o600
#: i386: mov eax, 20 (getpid there, writev here); int 0x80; ret.
_OTHER_ARCHITECTURE = bytes.fromhex("b814000000cd80c3")
_X32 = 0x40000000


def _outcome(act: Callable[[], object]) -> str:
    try:
        act()
    except OSError as error:
        return errno.errorcode.get(error.errno or 0, str(error.errno))
    except RuntimeError:  # how Python says that there is no thread
        return "EAGAIN"
    return "worked"


def _raw(number: int, *arguments: int) -> int:
    """Make a system call by number; raise what the kernel answers."""
    kernel = ctypes.CDLL(None, use_errno=True)
    answer: int = kernel.syscall(ctypes.c_long(number), *map(ctypes.c_long, arguments))
    if answer == -1:
        raise OSError(ctypes.get_errno(), "refused")
    return answer


def attempt_names(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Change and read names and modes in a directory that holds a `file`, without opening anything."""
    folder = Path(header["folder"])
    acts: dict[str, Callable[[], object]] = {
        "stat": partial(os.stat, folder / "file"),
        "mkdir": partial(os.mkdir, folder / "made"),
        "symlink": partial(os.symlink, "a message", folder / "mark"),
        "readlink": partial(os.readlink, folder / "mark" if header["marked"] else folder / "old mark"),
        "link": partial(os.link, folder / "file", folder / "linked"),
        "fifo": partial(os.mkfifo, folder / "fifo"),
        "chmod": partial(os.chmod, folder / "file", 0o777),
        "utime": partial(os.utime, folder / "file", (1, 1)),
        "setxattr": partial(os.setxattr, folder / "file", "user.mark", b"a message"),
        "truncate": partial(os.truncate, folder / "file", 0),
        "rename": partial(os.rename, folder / "victim", folder / "renamed"),
        "unlink": partial(os.unlink, folder / "doomed"),
        "chdir": partial(os.chdir, folder),
    }
    send({name: _outcome(act) for name, act in acts.items()}, b"")


def attempt_processes(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Start processes, threads and programs, and reach the search with signals, limits and priorities."""
    search = header["search"]
    acts: dict[str, Callable[[], object]] = {
        "fork": _fork,
        "thread": threading.Thread(target=int).start,
        "exec": partial(os.execv, "/nowhere/program", ["program"]),
        "signal": partial(os.kill, search, 0),
        "signal to the supervisor": partial(os.kill, os.getppid(), 0),
        "signal to all": partial(os.kill, -1, 0),
        "signal to the group": partial(os.killpg, 0, 0),
        "limits of others": partial(resource.prlimit, search, resource.RLIMIT_CORE),
        "priority of others": partial(os.getpriority, os.PRIO_PROCESS, search),
        "session": partial(os.getsid, search),
        "watch": partial(os.pidfd_open, search),
    }
    send({name: _outcome(act) for name, act in acts.items()}, b"")


def _fork() -> None:
    pid = os.fork()
    if pid == 0:
        os._exit(0)
    os.waitpid(pid, 0)


def attempt_channels(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Make what another candidate could find: System V shared memory, semaphores and queues, all removed again."""
    kernel = ctypes.CDLL(None, use_errno=True)

    def make(name: str, *arguments: int) -> None:
        made = getattr(kernel, name)(0, *arguments, _IPC_CREATE)
        if made == -1:
            raise OSError(ctypes.get_errno(), name)
        remove = {"shmget": (kernel.shmctl, (made, 0, 0)), "msgget": (kernel.msgctl, (made, 0, 0))}
        act, values = remove.get(name, (kernel.semctl, (made, 0, 0)))
        act(*values)

    acts: dict[str, Callable[[], object]] = {
        "shared memory": partial(make, "shmget", _SHARED_BYTES),
        "queue": partial(make, "msgget"),
        "semaphores": partial(make, "semget", 1),
    }
    send({name: _outcome(act) for name, act in acts.items()}, b"")


def attempt_every_number(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Make every system call below a number, and as x32, that is in no list; report those that were not refused."""
    spared = {*MACHINES[header["machine"]].allowed, *header["spared"]}
    numbers = [number for number in range(header["below"]) if number not in spared]
    numbers += [number | _X32 for number in range(header["below"])]
    through = [number for number in numbers if _outcome(partial(_raw, number, *(-1,) * 6)) != "EPERM"]
    send({"tried": len(numbers), "through": through}, b"")


def call_as_another_architecture(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Make a 32-bit call from machine code; answer with what it returned."""
    code = mmap.mmap(-1, mmap.PAGESIZE, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)
    code.write(_OTHER_ARCHITECTURE)
    address = ctypes.addressof(ctypes.c_char.from_buffer(code))
    send({"pid": os.getpid(), "returned": ctypes.CFUNCTYPE(ctypes.c_int)(address)()}, b"")


def abort(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """End as a failed assertion in native code does, which sends itself a signal."""
    os.abort()


def handle_own_signal(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Send itself a signal and answer from its handler."""
    signal.signal(signal.SIGUSR1, lambda *_: send("handled", b""))
    signal.raise_signal(signal.SIGUSR1)


def import_more(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Import a module that nobody imported yet, and say how that failed."""
    try:
        __import__(header)
    except ImportError as error:
        send(str(error), b"")
