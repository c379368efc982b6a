"""The zygote: imports the entries (and with them torch) once, maps the data, and forks a supervisor for each job.

It has one thread and a cleared environment, and does nothing but fork and reap. When it ends, or the search, everything
below it ends too.
"""

import gc
import importlib
import os
import select
import socket
from pathlib import Path
from typing import Any

import numpy as np

from tacevo.errors import SandboxError
from tacevo.sandbox.child import Arrays, Entry, Equip
from tacevo.sandbox.kernel import become_subreaper, keep_priority, protect_memory
from tacevo.sandbox.processes import close_all_but, end_own_descendants
from tacevo.sandbox.protocol import Channel, Header, Message, Sort, describe
from tacevo.sandbox.supervisor import supervise

_OUTPUT, _ERRORS = 1, 2


def main(descriptor: int) -> None:
    """Serve jobs until the search closes its end of the socket `descriptor`."""
    keep_priority()
    gc.disable()  # what is imported is kept, and searching it for garbage took a tenth of the start
    protect_memory()
    become_subreaper()
    search = Channel(socket.socket(fileno=descriptor))
    try:
        try:
            entries, equip = _prepare(search.receive().read_header())
        finally:  # the search, which sends the files when it has them, reads no answer before
            files = search.receive().read_header()
        arrays = {name: np.load(Path(path), mmap_mode="r") for name, path in files.items()}
    except Exception as error:
        search.send(Message.of(Sort.setup, {"error": describe(error)}))
        return
    search.send(Message.of(Sort.setup, {"error": None}))
    os.dup2(_OUTPUT, _ERRORS)  # what a candidate writes goes to /dev/null
    _serve(search.stream, entries, arrays, equip)
    os._exit(0)  # freeing torch object by object would take half a second


def _prepare(setup: Header) -> tuple[dict[str, Entry], Equip | None]:
    """Import the entries that the search names, and what equips their processes.

    Raises:
        SandboxError: an import started threads, which a fork would lose.
    """
    entries: dict[str, Entry] = {name: _import(entry) for name, entry in setup["entries"].items()}
    equip: Equip | None = None if setup["equip"] is None else _import(setup["equip"])
    for name in setup["imports"]:
        importlib.import_module(name)
    threads = len(os.listdir("/proc/self/task"))
    if threads > 1:
        expected, remedy = "one thread in the zygote", "set OMP_NUM_THREADS=1 for it"
        raise SandboxError(f"{threads} threads", expected=expected, remedy=remedy)
    gc.collect()
    gc.enable()
    gc.freeze()  # so that no garbage collection in a child writes to these shared pages
    return entries, equip


def _import(entry: str) -> Any:
    """Import a function named `module:function`."""
    module, _, function = entry.partition(":")
    return getattr(importlib.import_module(module), function)


def _serve(search: socket.socket, entries: dict[str, Entry], arrays: Arrays, equip: Equip | None) -> None:
    """Fork a supervisor for each socket that arrives, reap those that end, and in the end kill all."""
    supervisors: dict[int, int] = {}  # descriptor that shows its end -> process id
    poll = select.poll()
    poll.register(search, select.POLLIN)
    while True:
        happened = {descriptor for descriptor, _ in poll.poll()}
        for descriptor in happened & supervisors.keys():
            poll.unregister(descriptor)
            os.close(descriptor)
            os.waitpid(supervisors.pop(descriptor), 0)
            end_own_descendants(spare=supervisors.values())  # orphans, where a candidate killed its supervisor
        if search.fileno() in happened:
            data, jobs, *_ = socket.recv_fds(search, 1, 1)
            if not data:
                break
            pid = _fork_supervisor(jobs[0], entries, arrays, equip)
            os.close(jobs[0])
            descriptor = os.pidfd_open(pid)
            supervisors[descriptor] = pid
            poll.register(descriptor, select.POLLIN)
    end_own_descendants()


def _fork_supervisor(job: int, entries: dict[str, Entry], arrays: Arrays, equip: Equip | None) -> int:
    """Start the trusted process of one job; return its process id."""
    pid = os.fork()
    if pid == 0:
        try:
            close_all_but(job)
            supervise(socket.socket(fileno=job), entries, arrays, equip)
        finally:
            os._exit(0)  # the zygote's code further up the stack must not run here
    return pid
