"""The zygote: imports the entries (and with them torch) once, maps the data, and forks a supervisor for each job.

It has one thread, a cleared environment and no task of its own beside forking and reaping. Its end, or that of
the search, ends everything below it.
"""

import gc
import importlib
import os
import select
import socket
from pathlib import Path

import numpy as np

from tacevo.errors import SandboxError
from tacevo.records import Json
from tacevo.sandbox.child import Arrays, Entry
from tacevo.sandbox.kernel import become_subreaper, protect_memory
from tacevo.sandbox.processes import close_all_but, end_own_descendants
from tacevo.sandbox.protocol import Channel, Message, Sort, describe
from tacevo.sandbox.supervisor import supervise

_OUTPUT, _ERRORS = 1, 2


def main(descriptor: int) -> None:
    """Serve jobs until the search closes its end of the socket `descriptor`."""
    gc.disable()  # what is imported is kept; looking through it again and again would be a tenth of the start
    protect_memory()
    become_subreaper()
    search = Channel(socket.socket(fileno=descriptor))
    try:
        entries, arrays = _prepare(search.receive().read_header())
    except Exception as error:
        search.send(Message.of(Sort.setup, {"error": describe(error)}))
        return
    search.send(Message.of(Sort.setup, {"error": None}))
    os.dup2(_OUTPUT, _ERRORS)  # what a candidate prints goes the way of its output, to /dev/null
    _serve(search.stream, entries, arrays)
    os._exit(0)  # to take torch apart, object by object, would be half a second of work for nobody


def _prepare(setup: Json) -> tuple[dict[str, Entry], Arrays]:
    """Import the entries and map the arrays, as the search names them.

    Raises:
        SandboxError: an import started threads, which a fork would lose.
    """
    entries = {name: _import(place) for name, place in setup["entries"].items()}
    for name in setup["imports"]:
        importlib.import_module(name)
    arrays = {name: np.load(Path(path), mmap_mode="r") for name, path in setup["arrays"].items()}
    threads = len(os.listdir("/proc/self/task"))
    if threads > 1:
        raise SandboxError(f"the zygote needs one thread; it has {threads}. Set OMP_NUM_THREADS=1 in its environment")
    gc.collect()
    gc.enable()
    gc.freeze()  # what is imported stays shared: no collection of a child's touches these pages
    return entries, arrays


def _import(place: str) -> Entry:
    """Find an entry by `module:function`."""
    module, _, function = place.partition(":")
    entry: Entry = getattr(importlib.import_module(module), function)
    return entry


def _serve(search: socket.socket, entries: dict[str, Entry], arrays: Arrays) -> None:
    """Fork a supervisor for each socket that comes in, reap those that end, and at last end all."""
    supervisors: dict[int, int] = {}  # descriptor that tells of its end -> process id
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
            pid = _fork_supervisor(jobs[0], entries, arrays)
            os.close(jobs[0])
            descriptor = os.pidfd_open(pid)
            supervisors[descriptor] = pid
            poll.register(descriptor, select.POLLIN)
    end_own_descendants()


def _fork_supervisor(job: int, entries: dict[str, Entry], arrays: Arrays) -> int:
    """Start the trusted process of one job; give its process id."""
    pid = os.fork()
    if pid == 0:
        try:
            close_all_but(job)
            supervise(socket.socket(fileno=job), entries, arrays)
        finally:
            os._exit(0)  # the frames of the zygote lie above: nothing of them may run here
    return pid
