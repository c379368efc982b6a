"""How much of its workers' time a search spends on other things than training."""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from typing import Any
from unittest import mock

from benchmarks.timing import Figure
from tacevo.cli.app import main
from tacevo.sandbox.client import Died, Finished, Sandbox

#: Each has a core of its own.
WORKERS = 2


def beside_training(*, settings: Sequence[str] = ("experiment=demo",)) -> Iterator[Figure]:
    """Search once; the whole is the time of a command, from its start to its end, by its number of workers.

    Beside trainings there are probes; and starts, ends of generations and the end, in which a worker waits.
    """
    with tempfile.TemporaryDirectory() as folder:
        places = (f"run.dir={folder}/run", f"store.root={folder}/cache", f"executor.workers={WORKERS}", "tracking=none")
        began = time.perf_counter()
        command = [sys.executable, "-m", "benchmarks.share", "search", *settings, *places]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=True)
        whole = WORKERS * (time.perf_counter() - began)
    jobs = json.loads(done.stdout.splitlines()[-1])
    trainings, probes = (sum(seconds for kind, seconds in jobs if kind == entry) for entry in ("train", "probe"))
    yield _figure("that is not training", 1 - trainings / whole)
    yield _figure("of probes", probes / whole)


def _figure(name: str, part: float) -> Figure:
    return Figure(title="the demo's search, time of its workers", name=name, value=100 * part, unit="%")


def _command() -> int:
    """Run a command of tacevo; print last the entry and the seconds of each of its confined jobs."""
    jobs: list[tuple[str, float]] = []
    run = Sandbox.run

    def timed(sandbox: Sandbox, entry: str, *rest: Any) -> Finished | Died:
        began = time.perf_counter()
        try:
            return run(sandbox, entry, *rest)
        finally:
            jobs.append((entry, time.perf_counter() - began))

    with mock.patch.object(Sandbox, "run", timed):
        status = main(sys.argv[1:])
    print(json.dumps(jobs))
    return status


if __name__ == "__main__":
    sys.exit(_command())
