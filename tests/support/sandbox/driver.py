"""What stands for a GPU's driver in a sandbox: files for its devices, a thread of its own, and what a candidate tries.

The directory of these files is beneath `DEVICES`; `outside` is a file beside them.
"""

import errno
import fcntl
import mmap
import os
import queue
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

from tacevo.sandbox.child import Arrays, Send

_ASKED: "queue.Queue[Callable[[], object]]" = queue.Queue()
_TOLD: "queue.Queue[str]" = queue.Queue()


def equip(header: Any, payload: bytes, arrays: Arrays) -> Arrays:
    """Start the driver: it opens its device, reads a library, and leaves a thread and an open file behind."""
    opened = os.open(header["device"], os.O_RDWR)
    with open(os.__file__, encoding="utf-8") as library:
        library.read(10)
    threading.Thread(target=_serve, daemon=True).start()
    began = {"write before": _outcome(partial(os.open, header["outside"], os.O_WRONLY))}
    return {**arrays, "opened": opened, "began": began}


def _serve() -> None:
    while True:
        _TOLD.put(_outcome(_ASKED.get()))


def use(header: Any, payload: bytes, arrays: Arrays, send: Send) -> None:
    """Try what a driver does, and what a candidate must not; report the outcome of each by name."""
    device, outside = header["device"], header["outside"]
    acts: dict[str, Callable[[], object]] = {
        "open the device": partial(os.open, device, os.O_RDWR),
        "open another": partial(os.open, header["other"], os.O_RDWR),
        "map it": partial(mmap.mmap, arrays["opened"], mmap.PAGESIZE),
        "command": partial(fcntl.ioctl, arrays["opened"], 0xC020462A, bytes(32)),
        "event": partial(os.eventfd, 0),
        "thread": threading.Thread(target=int).start,
        "terminal": partial(fcntl.ioctl, arrays["opened"], 0x5412, b"x"),
        "read": partial(os.open, outside, os.O_RDONLY),
        "write": partial(os.open, outside, os.O_WRONLY),
        "make": partial(os.open, f"{outside}.new", os.O_WRONLY | os.O_CREAT),
        "make a device": partial(os.open, f"{device}.new", os.O_WRONLY | os.O_CREAT),
        "list": partial(os.listdir, os.path.dirname(device)),
        "library": partial(os.open, os.__file__, os.O_RDONLY),
        "environment of the search": partial(os.open, f"/proc/{header['search']}/environ", os.O_RDONLY),
        "fork": _fork,
        "signal by a file": partial(fcntl.fcntl, arrays["opened"], fcntl.F_SETOWN, header["search"]),
        "affinity of the search": partial(os.sched_setaffinity, header["search"], [0]),
        "program": partial(subprocess.run, [sys.executable, "-c", ""]),
        "network": lambda: socket.socket().connect(("127.0.0.1", header["port"])),
        "signal": partial(os.kill, header["search"], 0),
        "limits": partial(os.setpriority, os.PRIO_PROCESS, 0, 19),
    }
    report = {**arrays["began"], **{name: _outcome(act) for name, act in acts.items()}}
    for name in ("library", "write", "network", "fork", "terminal", "environment of the search", "open the device"):
        _ASKED.put(acts[name])
        report[f"{name}, driver's thread"] = _TOLD.get(timeout=10)
    report |= {f"remove {name}": _outcome(partial(os.unlink, name)) for name in (outside, device)}
    send(report, b"")


def _fork() -> None:
    if (pid := os.fork()) == 0:
        os._exit(0)
    os.waitpid(pid, 0)


def _outcome(act: Callable[[], object]) -> str:
    try:
        act()
    except OSError as error:
        return errno.errorcode.get(error.errno or 0, str(error))
    except Exception as error:
        return type(error).__name__
    return "worked"
