"""How figures are taken on a noisy machine: interleaved, the median of several, compared by ratio."""

import contextlib
import os
import resource
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

Name = TypeVar("Name")


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """One line of `make bench`: a value of ours beside a peer's."""

    title: str
    #: What was measured, and its value in `unit`.
    name: str
    value: float
    unit: str
    #: The same of the peer; None where there is none.
    peer: str | None = None
    peer_value: float | None = None
    #: Whether more of the unit is better, as for a rate.
    more_is_better: bool = False

    @property
    def ratio(self) -> float | None:
        """How many times better ours is: 2 means twice the rate, or half the time or memory; None without a peer."""
        if self.peer_value is None:
            return None
        return self.value / self.peer_value if self.more_is_better else self.peer_value / self.value

    def __str__(self) -> str:
        ours = f"{self.title}: {self.name} {number(self.value)} {self.unit}"
        if self.ratio is None or self.peer_value is None:
            return ours
        return f"{ours}, {self.peer} {number(self.peer_value)} {self.unit}; ratio {self.ratio:.2f}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """What a command took."""

    #: Wall time, the start of the interpreter included.
    seconds: float
    #: Of all processors, without waiting for disks and other processes.
    processor_seconds: float
    #: Peak of its memory, in MB (1,000,000 bytes).
    memory: float


def number(value: float) -> str:
    """Write a value with three significant digits, and whole where it has more."""
    return f"{value:,.0f}" if value >= 1000 else f"{value:.3g}"


def medians(
    rivals: Mapping[Name, Callable[[], object]], *, rounds: int, clock: Callable[[], float] = time.perf_counter
) -> dict[Name, float]:
    """Time rivals in turn, round by round; return each one's median in seconds, by wall time or another clock."""
    seconds: dict[Name, list[float]] = {name: [] for name in rivals}
    for _ in range(rounds):
        for name, work in rivals.items():
            began = clock()
            work()
            seconds[name].append(clock() - began)
    return {name: statistics.median(values) for name, values in seconds.items()}


def report(title: str, rates: Mapping[str, float], *, unit: str, count: int | None = None) -> Figure:
    """Return the figure that two medians give.

    Args:
        title: what was measured.
        rates: two medians in seconds, ours first.
        unit: what is counted.
        count: of the units that one measurement holds; None reports seconds.
    """
    (name, mine), (peer, theirs) = rates.items()
    if count is None:
        return Figure(title=title, name=name, value=mine, unit=unit, peer=peer, peer_value=theirs)
    return Figure(
        title=title,
        name=name,
        value=count / mine,
        unit=f"{unit}/s",
        peer=peer,
        peer_value=count / theirs,
        more_is_better=True,
    )


def children_seconds() -> float:
    """Return the processor seconds of all processes that this one started, as far as they have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def descendants_seconds() -> float:
    """Return the processor seconds of all processes below this one, those that still run included."""
    time.sleep(0.2)  # what has just ended is counted by its parent only when that has noticed
    known: dict[int, tuple[int, float]] = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it has ended
            values = path.read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
            known[int(path.parent.name)] = int(values[1]), sum(map(int, values[11:15])) / os.sysconf("SC_CLK_TCK")
    below, waiting = 0.0, [os.getpid()]
    while waiting:
        parent = waiting.pop()
        children = [process for process, (above, _) in known.items() if above == parent]
        below += sum(known[process][1] for process in children)
        waiting += children
    return below + children_seconds()


def resident(name: str) -> float:
    """Read a figure of this process's memory, in MB (1,000,000 bytes).

    Args:
        name: `VmRSS`, or `VmHWM` for its peak; unlike `ru_maxrss` that one knows nothing of the process before `exec`.
    """
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name)) * 1024 / 1e6
