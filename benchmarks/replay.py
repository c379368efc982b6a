"""How long a replay takes, what memory it needs and how large its bundle is: 1,000 and 10,000 candidates."""

import io
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from benchmarks.synthetic import record_synthetic
from tacevo.runs.progress import Progress

#: Generations of 50 candidates: the paper's size, and ten times that.
GENERATIONS = (20, 200)

#: A command in a process of its own, which prints its processor seconds and the peak of its resident memory last.
_SCRIPT = """
import json, sys, time
from benchmarks.timing import resident
from tacevo.cli.app import main
status = main(sys.argv[1:])
print(json.dumps([time.process_time(), resident("VmHWM")]))
sys.exit(status)
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """What one command took."""

    #: Wall time, the start of the interpreter included.
    seconds: float
    #: Of all processors, without waiting for disks and other processes.
    processor_seconds: float
    #: Peak of its resident memory, in MB (1,000,000 bytes).
    memory: float

    def __str__(self) -> str:
        return f"{self.seconds:.1f} s ({self.processor_seconds:.1f} CPU s), {self.memory:.0f} MB"


def synthetic_replays() -> str:
    """Replay synthetic runs of both sizes as folders, publish them, and replay the bundles."""
    lines, seconds = [], []
    for generations in GENERATIONS:
        with tempfile.TemporaryDirectory() as folder:
            record_synthetic(Path(folder), generations, Progress(Console(file=io.StringIO())))
            line, took = measured(Path(folder))
        lines.append(line)
        seconds.append(took)
    folders, bundles = (few_and_many[1] / few_and_many[0] for few_and_many in zip(*seconds, strict=True))
    ratios = (
        f"ten times as many candidates: {folders:.1f} times the CPU seconds of a replay, {bundles:.1f} of a bundle's"
    )
    return "\n".join([*lines, ratios])


def measured(folder: Path) -> tuple[str, tuple[float, float]]:
    """Measure one synthetic run.

    Args:
        folder: what `record_synthetic` wrote to.

    Returns:
        One line, and the processor seconds of the replays of the folder and of the bundle.
    """
    run, bundle = str(folder / "run"), str(folder / "run.zip")
    lines = len((folder / "run" / "ledger.jsonl").read_bytes().splitlines())
    replayed = cost_of("replay", run)
    published = cost_of("publish", run, "-o", bundle)
    verified = cost_of("replay", bundle)
    size = Path(bundle).stat().st_size / 1e6
    line = (
        f"a run of {lines:,} ledger lines: replay {replayed}; publish {published}; bundle {size:.2f} MB; "
        f"replay of the bundle {verified}"
    )
    return line, (replayed.processor_seconds, verified.processor_seconds)


def cost_of(*arguments: str) -> Cost:
    """Run a command of tacevo in a process of its own.

    Raises:
        CalledProcessError: it failed.
    """
    began = time.perf_counter()
    command = [sys.executable, "-c", _SCRIPT, *arguments]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=True)
    seconds = time.perf_counter() - began
    processor, memory = json.loads(done.stdout.splitlines()[-1])
    return Cost(seconds=seconds, processor_seconds=processor, memory=memory)
