"""How figures are taken on a noisy machine: interleaved, the median of several, compared by ratio."""

import statistics
import time
from collections.abc import Callable, Mapping
from pathlib import Path


def medians(rivals: Mapping[str, Callable[[], object]], *, rounds: int) -> dict[str, float]:
    """Time rivals in turn, round by round; give each one's median in seconds."""
    seconds: dict[str, list[float]] = {name: [] for name in rivals}
    for _ in range(rounds):
        for name, work in rivals.items():
            began = time.perf_counter()
            work()
            seconds[name].append(time.perf_counter() - began)
    return {name: statistics.median(values) for name, values in seconds.items()}


def report(title: str, found: Mapping[str, float], *, unit: str, per_second: int | None = None) -> str:
    """Write one line: ours, the peer's, and how many times faster ours is.

    Args:
        title: what was measured.
        found: two medians in seconds, ours first.
        unit: what is counted.
        per_second: how many units one measurement holds; None reports seconds.
    """
    (ours, mine), (peer, theirs) = found.items()
    if per_second is None:
        return f"{title}: {ours} {mine:.3f} {unit}, {peer} {theirs:.3f} {unit}; ratio {theirs / mine:.2f}"
    rates = f"{ours} {per_second / mine:,.4g} {unit}/s, {peer} {per_second / theirs:,.4g} {unit}/s"
    return f"{title}: {rates}; ratio {theirs / mine:.2f}"


def resident(name: str) -> float:
    """Read a figure of this process's memory, in MB (1,000,000 bytes).

    Args:
        name: `VmRSS`, or `VmHWM` for its peak; unlike `ru_maxrss` that one knows nothing of the process before `exec`.
    """
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name)) * 1024 / 1e6
