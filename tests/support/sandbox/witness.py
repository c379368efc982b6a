"""Who saw which processes: candidates as /proc shows them while they run."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tacevo.sandbox.processes import children, descendants


def candidates() -> set[int]:
    """Find every process below a supervisor, which is a zygote's child, as a zygote is one of this process."""
    supervisors = [supervisor for zygote in children(os.getpid()) for supervisor in children(zygote)]
    return {pid for supervisor in supervisors for pid in descendants(supervisor)}


def is_gone(pid: int) -> bool:
    """Return whether a process has ended and been reaped."""
    return not Path(f"/proc/{pid}").exists()


def living(pids: set[int]) -> list[int]:
    """List those of the processes that are not gone; others may be added to the set meanwhile."""
    return [pid for pid in pids.copy() if not is_gone(pid)]


@contextmanager
def watching_candidates() -> Iterator[set[int]]:
    """Return a set that gathers the processes of all candidates that run until the body ends."""
    seen: set[int] = set()
    over = threading.Event()

    def watch() -> None:
        while not over.wait(0.01):
            seen.update(candidates())

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield seen
    finally:
        over.set()
        watcher.join()
