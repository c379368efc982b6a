"""Compares what this CPU computes under portable numerics with what is recorded; imports no torch."""

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from tacevo.choices import Numerics
from tacevo.environment import machine, versions
from tacevo.errors import ConfigError
from tacevo.records import Json
from tacevo.sandbox.caches import TORCH
from tacevo.text import listed
from tacevo.training.numerics import check_machine, environment

#: The levels of numerics that promise equal bits on other CPUs.
LEVELS = (Numerics.portable, Numerics.portable512)

#: Of the results that differ, so many are named in a line; a report names all.
_NAMED = 3
_RECORDED = Path(__file__).parent / "recorded"
#: What /proc/cpuinfo and /sys say of a CPU, and decides what libraries choose.
_CPUINFO = ("vendor_id", "cpu family", "model", "model name", "stepping", "cache size", "flags")
_CACHES = Path("/sys/devices/system/cpu/cpu0/cache")


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """One level, on this machine."""

    level: Numerics
    #: The digest of each result, 16 hex digits; none where nothing was computed.
    digests: Mapping[str, str]
    #: Names of results that differ without a reason: the promise does not hold here.
    differing: Sequence[str] = ()
    #: Names of results that differ and run a kernel whose bits may depend on the CPU: a candidate with it is flagged.
    flagged: Sequence[str] = ()
    #: What keeps this machine from comparing, as a CPU without the instructions; None where nothing does.
    reason: str | None = None
    #: The exit status of a computation that failed; 0 where none did.
    status: int = 0
    #: The last line that it wrote, which may name files and so is in no report.
    last_line: str = ""

    @property
    def is_sound(self) -> bool:
        """Whether nothing speaks against the promise: it holds here, or it cannot be tried."""
        return not self.differing and not self.status

    def __str__(self) -> str:
        """Return what holds here, in one line."""
        if self.reason is not None:
            return f"not compared: {self.reason}"
        if self.status:
            return f"not computed: the process ended with status {self.status}"
        results = len(self.digests)
        equal = results - len(self.differing) - len(self.flagged)
        flagging = f"; the other {len(self.flagged)} flag a candidate as not_portable" if self.flagged else ""
        if not self.differing:
            return f"as recorded ({equal} of {results}){flagging}"
        first, more = self.differing[:_NAMED], len(self.differing) - _NAMED
        named = listed(first) + (f" and {more} more" if more > 0 else "")
        return f"{len(self.differing)} of {results} results differ from the record: {named}{flagging}"


def recorded(level: Numerics) -> dict[str, str]:
    """Read the recorded digests of a level: 16 hex digits each, by what was computed."""
    digests: dict[str, str] = json.loads((_RECORDED / f"{level}.json").read_text(encoding="utf-8"))
    return digests


def compare(levels: Sequence[Numerics] = LEVELS) -> list[Compared]:
    """Compute all recorded results on this CPU, each level in a process of its own: some seconds of one core each."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(_compared, levels))


def report(compared: Sequence[Compared]) -> Json:
    """Return what makers of this project need of a CPU: its description, versions, and every digest."""
    return {
        "machine": machine(),
        "cpu": _cpu(),
        "versions": versions(),
        "levels": {
            str(each.level): {
                "says": str(each),
                "differing": list(each.differing),
                "flagged": list(each.flagged),
                "digests": dict(each.digests),
            }
            for each in compared
        },
    }


def _compared(level: Numerics) -> Compared:
    reason = _obstacle(level)
    if reason is not None:
        return Compared(level=level, digests={}, reason=reason)
    # In the system's directory: the user's own may hold modules of torch's names, or be gone.
    command = [sys.executable, "-P", "-m", "tacevo.reproduce.bits"]
    fixed = {"PYTHONHASHSEED": "0", "PYTHONPATH": os.pathsep.join(path for path in sys.path if os.path.isabs(path))}
    settings = {**os.environ, **fixed, **environment(level)}
    wanted = recorded(level)
    done = subprocess.run(
        command, env=settings, cwd="/", input=json.dumps(wanted), capture_output=True, text=True, check=False
    )
    if done.returncode:
        last_line = (done.stderr.strip() or "no message").splitlines()[-1]
        return Compared(level=level, digests={}, status=done.returncode, last_line=last_line)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    kernels = {what: more for what, _, *more in lines}
    digests = {what: digest for what, digest, *_ in lines}
    different = [what for what in wanted if digests.get(what) != wanted[what]]
    flagged = [what for what in different if any(kernels.get(what, ()))]
    return Compared(
        level=level,
        digests=digests,
        differing=[what for what in different if what not in flagged],
        flagged=flagged,
    )


def _obstacle(level: Numerics) -> str | None:
    """Return why a level cannot be compared here; None where it can."""
    try:
        check_machine(level)
    except ConfigError as error:
        return str(error)
    torch = versions()["torch"]
    return None if torch.partition("+")[0] == TORCH else f"recorded with torch {TORCH}; installed is {torch}"


def _cpu() -> dict[str, Json]:
    """Describe the first core."""
    table = Path("/proc/cpuinfo")
    text = table.read_text(errors="replace") if table.exists() else ""
    facts = [line.partition(":") for line in text.partition("\n\n")[0].splitlines()]
    said: dict[str, Json] = {name.strip(): fact.strip() for name, _, fact in facts if name.strip() in _CPUINFO}
    return {**said, "caches": dict(map(_cache, sorted(_CACHES.glob("index*"))))}


def _cache(folder: Path) -> tuple[str, str]:
    """Return a cache's level and kind, and its size, each `unknown` where the machine does not tell it."""
    facts = dict.fromkeys(("level", "type", "size"), "unknown")
    for fact in facts:
        with contextlib.suppress(OSError):
            facts[fact] = (folder / fact).read_text().strip()
    return f"L{facts['level']} {facts['type']}", facts["size"]
