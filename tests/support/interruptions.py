"""A real search that is killed: started, watched, ended by SIGKILL at a chosen moment, and then looked after."""

import contextlib
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType

import pytest
from smallest import SMALLEST
from waiting import eventually

from tacevo.sandbox.processes import descendants

#: A real search, as small as one can be that mutates, crosses over, rejects and trains.
SEARCH = [
    *SMALLEST,
    "search.generations=2",
    "search.candidates=4",
    "search.initial=2",
    "llm.slip_rate=0.3",
    "proposals.mutation_probability=0.5",
    "run.dir=run",
]
CANDIDATES = 1 + 2 + 2 * 4
_LINES = 1 + CANDIDATES + 3

#: Seconds after which something is taken for stuck; machines are busy, and the mirror steps back.
PATIENCE = 1200
#: For tests of several searches, the first of which (a fixture's) counts too; more than any one wait.
unhurried = pytest.mark.timeout(3 * PATIENCE)
_TICK = 0.002


class Phase(StrEnum):
    """What a search is doing; each begins with a sign that is seen from outside."""

    whenever = "whenever"  # without a sign: some time after the start
    making = "making data"
    completing = "completing"
    admitting = "admitting"
    evaluating = "evaluating"
    committing = "committing"
    mirroring = "writing MLflow"
    finishing = "finishing"


#: Where the sign of a phase appears, below the directory of the search: a new name, or another size or time of one.
_SIGNS = {
    Phase.making: "cache/data/.*part",
    Phase.completing: "cache/completions/*/*",
    Phase.admitting: "cache/answers/*/*",
    Phase.evaluating: "cache/probes/*/*",  # the next thing that happens to an admitted source
    Phase.committing: "run/ledger.jsonl",
    Phase.mirroring: "*mlflow.db*",
}

#: How long after its sign a phase is hit, at most, in seconds.
_SPREAD = {
    Phase.whenever: 3.0,
    Phase.making: 0.1,
    Phase.completing: 0.05,
    Phase.admitting: 0.3,
    Phase.evaluating: 0.5,
    Phase.committing: 0.03,
    Phase.mirroring: 1.0,
    Phase.finishing: 0.05,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Kill:
    """One kill -9."""

    phase: Phase
    #: Seconds after the phase's sign.
    delay: float
    #: Whether all processes below the search are killed with it, as by a batch system; else they must end themselves.
    family: bool


def draw_kills(counts: dict[Phase, int], seed: int) -> list[Kill]:
    """Draw so many kills of each phase, in a mixed order."""
    rng = random.Random(seed)
    kills = [
        Kill(phase=phase, delay=rng.random() * _SPREAD[phase], family=rng.random() < 0.4)
        for phase, count in counts.items()
        for _ in range(count)
    ]
    rng.shuffle(kills)
    return kills


def start(
    folder: Path,
    *overrides: str,
    environment: Mapping[str, str] = MappingProxyType({}),
    place: str = ".",
    umask: int = -1,
) -> subprocess.Popen[str]:
    """Start the search in a directory; every process of it, candidates too, names that directory in its command line.

    Args:
        folder: where; it keeps temporary files, too.
        overrides: of the search's configuration.
        environment: what is added to the environment.
        place: the working directory, below the folder.
        umask: -1 for that of this process.
    """
    for name in ("tmp", place):
        (folder / name).mkdir(parents=True, exist_ok=True)
    own = {"PYTHONPATH": os.pathsep.join([str(folder), os.environ["PYTHONPATH"]]), "TMPDIR": str(folder / "tmp")}
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "tacevo.cli.app", "search", *SEARCH, *overrides],
        cwd=folder / place,
        env={**os.environ, **own, **environment},
        umask=umask,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def finish(search: subprocess.Popen[str]) -> str:
    """Let a search go to its end; return the digest that it prints."""
    out, errors = search.communicate(timeout=PATIENCE)
    assert search.returncode == 0, errors
    name, _, digest = out.splitlines()[-1].partition(": ")
    assert name == "digest"
    return digest


def kill(search: subprocess.Popen[str], folder: Path, planned: Kill) -> bool:
    """Kill a search as planned; False where it ended before its phase came."""
    if not begins(planned.phase, search, folder):
        return False
    time.sleep(planned.delay)
    doomed = [search.pid, *(descendants(search.pid) if planned.family else ())]
    if search.poll() is not None:
        return False
    for pid in doomed:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    search.communicate(timeout=PATIENCE)
    return search.returncode == -signal.SIGKILL


def begins(phase: Phase, search: subprocess.Popen[str], folder: Path) -> bool:
    """Wait for the sign of a phase; False where the search ended without it."""
    before = _seen(folder, phase)
    return phase is Phase.whenever or comes(search, lambda: _has_begun(folder, phase, before))


def comes(search: subprocess.Popen[str], happens: Callable[[], bool]) -> bool:
    """Wait until something happens to a search; False where the search ended without it.

    Raises:
        TimeoutError: neither came about; the search was killed.
    """
    deadline = time.monotonic() + PATIENCE
    while not happens():
        if search.poll() is not None:
            return False
        if time.monotonic() > deadline:
            search.kill()
            raise TimeoutError(f"expected a sign of the search, or its end, within {PATIENCE} s; it was killed")
        time.sleep(_TICK)
    return True


def _has_begun(folder: Path, phase: Phase, before: set[tuple[str, int]]) -> bool:
    """Say whether the sign of a phase is there."""
    if phase is Phase.finishing:
        ledger = folder / "run" / "ledger.jsonl"
        return ledger.exists() and ledger.read_bytes().count(b"\n") == _LINES
    return bool(_seen(folder, phase) - before)


def _seen(folder: Path, phase: Phase) -> set[tuple[str, int]]:
    """List what lies where a phase shows, with times."""
    files: set[tuple[str, int]] = set()
    for path in folder.glob(_SIGNS[phase]) if phase in _SIGNS else ():
        try:
            files.add((path.name, path.stat().st_mtime_ns))
        except FileNotFoundError:
            continue
    return files


def ends(folder: Path) -> bool:
    """Wait until no living process names a directory or stands in it."""
    return eventually(lambda: not processes_of(folder), seconds=PATIENCE)


def processes_of(folder: Path) -> list[str]:
    """List the living processes that name a directory in their command line or stand in it."""
    commands = (_command_in(process, folder) for process in Path("/proc").glob("[0-9]*"))
    return [command for command in commands if command is not None]


def _command_in(process: Path, folder: Path) -> str | None:
    try:
        command = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        belongs = str(folder) in command or (process / "cwd").readlink().is_relative_to(folder)
    except OSError:
        return None
    return command if belongs and command else None


def leftovers(folder: Path) -> list[str]:
    """List temporary files, and hidden ones that are not locks."""
    names = [path for path in folder.rglob("*") if path != folder / "tmp"]
    hidden = [path for path in names if path.name.startswith(".") and not path.name.endswith("lock")]
    temporary = [path for path in names if path.name.endswith(("part", "-journal", ".tmp"))]
    return sorted({str(path.relative_to(folder)) for path in (*hidden, *temporary, *(folder / "tmp").rglob("*"))})


def results(folder: Path) -> dict[str, bytes]:
    """Read all that follows from a search's configuration, in its run directory and in its stores."""
    run = folder / "run"
    files = [run / "ledger.jsonl", run / "archive.json", run / "prompts.json", *(run / "candidates").iterdir()]
    files += [path for path in (folder / "cache").rglob("*") if path.is_file() and not path.name.endswith("lock")]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def mirrored(database: Path) -> tuple[int, str]:
    """Count the runs in MLflow's database, deleted ones left out, and return the digest that is tagged there."""
    with contextlib.closing(sqlite3.connect(database)) as connection:
        (count,) = connection.execute("select count(*) from runs where lifecycle_stage = 'active'").fetchone()
        tagged = connection.execute("select value from tags where key = 'tacevo.digest'").fetchall()
    return count, ",".join(value for (value,) in tagged)
