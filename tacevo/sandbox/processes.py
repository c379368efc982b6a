"""Process trees as /proc shows them: parents and children, memory, and how to kill them.

Linux only. Everything here runs in trusted processes that have one thread each.
"""

import contextlib
import os
import signal
import time
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

_PF_EXITING = 0x4  # include/linux/sched.h
_FLAGS = 6  # where the flags stand in /proc/<pid>/stat, counted from behind the name
_TIMES = slice(11, 15)  # where the times of itself and its children stand there: in user and in system mode
_PAUSE = 0.001  # seconds between two looks at a dying tree
_LAST_DESCRIPTOR = 2**31 - 1
_IN_MEMORY = frozenset({"tmpfs", "ramfs"})


def children(pid: int) -> list[int]:
    """List the children of a process and all its threads; none where it is gone."""
    return [int(child) for thread in _threads(pid) for child in _read(thread / "children").split()]


def descendants(pid: int, spare: Collection[int] = ()) -> Iterator[int]:
    """Yield every process below `pid`, parents first, except the spared children and the processes below those."""
    generation = [child for child in children(pid) if child not in spare]
    while generation:
        yield from generation
        generation = [child for parent in generation for child in children(parent)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Memory:
    """Resident memory of one process, in MiB; pages inherited through a fork count too."""

    #: The memory that no file backs: its own pages and shared ones.
    anonymous: float
    #: Pages of mapped files, such as libraries and images.
    of_files: float
    #: The most of both together that it ever held at once.
    peak: float


def memory(pid: int, mapped_mib: float = 0.0) -> Memory:
    """Read the memory of a process; all fields are 0 where it is gone.

    Of a file that lies in memory (tmpfs) the pages that are mapped count as shared, and nothing tells them from others.
    So of what is shared, as much as such files can take is theirs: `mapped_mib`.
    """
    fields = _status(pid)
    shared = _mib(fields, "RssShmem")
    of_files = min(shared, mapped_mib)
    return Memory(
        anonymous=_mib(fields, "RssAnon") + shared - of_files,
        of_files=_mib(fields, "RssFile") + of_files,
        peak=_mib(fields, "VmHWM"),
    )


def lies_in_memory(path: str) -> bool:
    """Return whether a file lies in a file system that has no disk."""
    device = os.stat(path).st_dev
    mounts = [line.partition(" - ") for line in _read(Path("/proc/self/mountinfo")).splitlines()]
    kinds = {rest.split()[0] for head, _, rest in mounts if head.split()[2] == f"{os.major(device)}:{os.minor(device)}"}
    return not kinds.isdisjoint(_IN_MEMORY)


def cpu_seconds(pid: int) -> float:
    """Read the processor time of a process and of its children that it has waited for; 0 where it is gone."""
    return sum(map(int, _figures(Path(f"/proc/{pid}"))[_TIMES])) / os.sysconf("SC_CLK_TCK")


def address_space_mib() -> float:
    """Return the address space of this process, in MiB."""
    return _mib(_status(os.getpid()), "VmSize")


def is_ending(pid: int) -> bool:
    """Return whether the whole process is exiting or gone; its files may be closed already."""
    figures = map(_figures, _threads(pid))
    return all(not thread or int(thread[_FLAGS]) & _PF_EXITING for thread in figures)


def end_own_descendants(spare: Collection[int] = ()) -> None:
    """Kill and reap every descendant of this process, which must be a subreaper, except the spared and theirs.

    The children of a killed process become the subreaper's, so a double fork or a new session does not escape. The
    loop ends when no descendant is left.
    """
    while doomed := list(descendants(os.getpid(), spare)):
        for pid in doomed:
            _kill(pid)
            with contextlib.suppress(ChildProcessError):  # a grandchild: it becomes ours when its parent is gone
                os.waitpid(pid, os.WNOHANG)
        time.sleep(_PAUSE)


def end_tree(pid: int) -> None:
    """Kill a process that is not ours and, before it, all its descendants, even where it is stopped."""
    while living := [below for below in descendants(pid) if _status(below)]:  # one that has ended waits to be reaped
        for below in living:
            _kill(below)
        time.sleep(_PAUSE)
    _kill(pid)


def close_all_but(descriptor: int) -> None:
    """Close every file of this process except the standard streams and one more."""
    os.closerange(3, descriptor)
    os.closerange(descriptor + 1, _LAST_DESCRIPTOR)


def _kill(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def _mib(fields: dict[str, str], name: str) -> float:
    """Read one field of a status, which is in kB."""
    return int(fields.get(name, "0").split()[0]) / 1024


def _status(pid: int) -> dict[str, str]:
    """Read the status of a process from a running thread; empty where there is none.

    /proc/<pid>/status is that of the first thread. After that thread has ended it shows no memory, although the other
    threads hold it all.
    """
    for thread in _threads(pid):
        lines = _read(thread / "status").splitlines()
        fields = {name: value.strip() for name, _, value in (line.partition(":") for line in lines)}
        if "VmRSS" in fields:
            return fields
    return {}


def _figures(directory: Path) -> list[str]:
    """Read the fields of `stat` behind the name, of a process or a thread; none where it is gone."""
    return _read(directory / "stat").rpartition(")")[2].split()


def _read(path: Path) -> str:
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""


def _threads(pid: int) -> list[Path]:
    """List the directories of a process's threads in /proc; none where it is gone."""
    directory = Path(f"/proc/{pid}/task")
    try:
        return [directory / thread for thread in os.listdir(directory)]
    except OSError:
        return []
