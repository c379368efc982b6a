"""How long a replay takes and what memory it needs: of 1,000 and of 2,000 candidates."""

import io
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console

from benchmarks.synthetic import record_synthetic
from benchmarks.timing import Cost, Figure
from tacevo.runs.progress import Progress

#: Generations of 50 candidates: the paper's size, and twice that; ten times would take a third of `make bench`.
GENERATIONS = (20, 40)

#: A command in a process of its own, which prints its processor seconds and the peak of its resident memory last.
_SCRIPT = """
import json, sys, time
from benchmarks.timing import resident
from tacevo.cli.app import main
status = main(sys.argv[1:])
print(json.dumps([time.process_time(), resident("VmHWM")]))
sys.exit(status)
"""


def synthetic_replays(*, generations: Sequence[int] = GENERATIONS) -> Iterator[Figure]:
    """Replay synthetic runs of two sizes as directories, publish them, and replay the bundles.

    The peer of the larger run is the smaller one: the ratio is 1 where a candidate costs the same in both.
    """
    costs = [_costs(count) for count in generations]
    (small, few), (large, many) = costs[0], costs[-1]
    for what, cost in many.items():
        yield Figure(
            title=f"{what}, a candidate",
            name=f"of {large:,}",
            value=1000 * cost.processor_seconds / large,
            unit="CPU ms",
            peer=f"of {small:,}",
            peer_value=1000 * few[what].processor_seconds / small,
        )
    for what, cost in few.items():
        title, name = f"{what}, one process", f"{small:,} candidates"
        yield Figure(title=title, name=name, value=cost.seconds, unit="s")
        yield Figure(title=f"{title}, peak memory", name=name, value=cost.memory, unit="MB")


def _costs(generations: int) -> tuple[int, dict[str, Cost]]:
    """Record a synthetic run; return the number of its candidates, and what is done with it costs."""
    with tempfile.TemporaryDirectory() as folder:
        record_synthetic(Path(folder), generations, Progress(Console(file=io.StringIO())))
        run, bundle = f"{folder}/run", f"{folder}/run.zip"
        candidates = Path(run, "ledger.jsonl").read_text(encoding="utf-8").count('"kind":"candidate"')
        return candidates, {
            "replay of a run": command_cost("replay", run),
            "publication": command_cost("publish", run, "-o", bundle),
            "replay of a bundle": command_cost("replay", bundle),
        }


def command_cost(*arguments: str) -> Cost:
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
