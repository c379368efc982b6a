"""Promise: whatever fails around a search, its user reads one clear line, nothing is lost, and the digest stays.

Full and read-only disks, damaged stores and ledgers, neighbours in the same store, processes killed by somebody, an
MLflow that is not there or goes away, and clocks that run backwards. What single files do under such faults is in the
tests of their modules.
"""

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from commands import tacevo
from interruptions import (
    CANDIDATES,
    SEARCH,
    Phase,
    begins,
    comes,
    ends,
    finish,
    leftovers,
    mirrored,
    results,
    start,
    unhurried,
)
from mounts import enlarge, read_only, small_disk
from smallest import UNTRACKED

from tacevo.cli.app import main
from tacevo.sandbox.processes import children, descendants
from tacevo.storage.store import SEARCHED

pytestmark = unhurried

Whole = tuple[Path, str]


def here(*overrides: str) -> int:
    """Search in this process; return the exit status."""
    return main(["search", *SEARCH, UNTRACKED, *overrides])


def refused(search: subprocess.Popen[str]) -> str:
    """Let a search end that cannot go on; return its one line of error."""
    _, errors = search.communicate()
    assert search.returncode == 2, errors
    assert "Traceback" not in errors
    (line,) = [line for line in errors.splitlines() if line.startswith("error: ")]
    return line


def flip_a_bit(data: bytes) -> bytes:
    """Change one bit in the middle."""
    place = len(data) // 2
    return data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]


def cut_in_half(data: bytes) -> bytes:
    """Lose the second half."""
    return data[: len(data) // 2]


@pytest.mark.parametrize("damage", [flip_a_bit, pytest.param(cut_in_half, marks=pytest.mark.slow)])
def test_damaged_entry_of_any_store_is_named_and_can_be_computed_again(
    damage: Callable[[bytes], bytes], copied: Path, whole_search: Whole, capsys: pytest.CaptureFixture[str]
) -> None:
    """A search reads no damaged entry; without them it computes what is missing, and ends with the same bytes."""
    ledger = (copied / "run" / "ledger.jsonl").read_bytes()
    entries = [sorted((copied / "cache" / kind).glob("*/*.json"))[0] for kind in SEARCHED]
    for entry in entries:
        sound = entry.read_bytes()
        entry.write_bytes(damage(sound))
        assert here() == 2
        errors = capsys.readouterr().err
        assert entry.name in errors
        assert "restore the file from a copy, or delete it so that it is computed again" in errors
        assert (copied / "run" / "ledger.jsonl").read_bytes() == ledger
        entry.write_bytes(sound)
    for entry in entries:
        entry.unlink()
    assert here() == 0
    assert f"digest: {whole_search[1]}" in capsys.readouterr().out
    assert results(copied) == results(whole_search[0])


def test_damaged_ledger_is_refused_and_a_cut_one_is_completed(
    copied: Path, whole_search: Whole, capsys: pytest.CaptureFixture[str]
) -> None:
    """A flipped bit is named by its line and nothing is written over it; a lost end is written again."""
    ledger = copied / "run" / "ledger.jsonl"
    sound = ledger.read_bytes()
    ledger.write_bytes(flip_a_bit(sound))
    assert here() == 2
    assert "ledger.jsonl, line " in capsys.readouterr().err
    assert ledger.read_bytes() == flip_a_bit(sound)
    ledger.write_bytes(cut_in_half(sound))
    assert here() == 0
    assert f"digest: {whole_search[1]}" in capsys.readouterr().out
    assert results(copied) == results(whole_search[0])


@pytest.mark.parametrize(
    "name",
    [
        "run.json",
        "archive.json",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("timings.jsonl", "prompts.json")),
    ],
)
def test_damaged_file_beside_the_ledger_costs_no_result(
    name: str, copied: Path, whole_search: Whole, capsys: pytest.CaptureFixture[str]
) -> None:
    """What follows from the ledger can be written again; where a search refuses, it says what to delete."""
    (copied / "run" / name).write_bytes(cut_in_half((copied / "run" / name).read_bytes()))
    status = here()
    if status:
        assert re.search(rf"{name}: .*; restore it, or delete it", capsys.readouterr().err)
        (copied / "run" / name).unlink()
        status = here()
    assert status == 0
    assert f"digest: {whole_search[1]}" in capsys.readouterr().out
    assert main(["replay", "run"]) == 0


@pytest.mark.slow
def test_full_store_that_cannot_be_written_serves_a_search(copied: Path, whole_search: Whole, tmp_path: Path) -> None:
    """Where every answer is recorded, a read-only store is enough; nothing is swept up there, and nothing complains."""
    (copied / "cache" / "probes" / ".dead.json.0123456789abcdef.part").write_text("{")
    with read_only(copied / "cache"):
        assert finish(start(tmp_path, UNTRACKED, "run.dir=other")) == whole_search[1]


@pytest.mark.slow
def test_store_that_cannot_be_written_is_one_line(
    copied: Path, whole_search: Whole, capsys: pytest.CaptureFixture[str]
) -> None:
    """The missing answer is computed but cannot be kept: the search stops, and goes on once it can write."""
    next((copied / "cache" / "evaluations").glob("*/*.json")).unlink()
    shutil.rmtree(copied / "run")
    with read_only(copied / "cache"):
        assert here() == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert "cache/evaluations/" in line
    assert "cannot be written: Read-only file system; what stood there is unchanged" in line
    assert here() == 0
    assert f"digest: {whole_search[1]}" in capsys.readouterr().out
    assert results(copied) == results(whole_search[0])


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_disk_that_is_full_again_and_again_costs_nothing(whole_search: Whole, tmp_path: Path) -> None:
    """On a disk that grows by 32 KiB a time each search stops with one line or ends well, with the same bytes."""
    folder = tmp_path / "disk"
    folder.mkdir()
    size, stops = 64, list[str]()
    with small_disk(folder, size):
        while (search := start(folder, UNTRACKED)).wait() != 0:
            stops.append(refused(search))
            size += 32
            enlarge(folder, size)
        assert finish(search) == whole_search[1]
        assert ends(folder)
        assert leftovers(folder) == []
        assert results(folder) == results(whole_search[0])
    print(f"stops: {len(stops)}", *stops, sep="\n")
    assert len(stops) > 4
    assert all("room" in stop or "No space left" in stop for stop in stops)


@pytest.mark.slow
def test_two_searches_share_one_store_at_once(whole_search: Whole, tmp_path: Path) -> None:
    """Started together with an empty store, both give the digest, and the store is that of one of them alone."""
    pair = [start(tmp_path, UNTRACKED, f"run.dir={name}") for name in ("run", "other")]
    assert [finish(search) for search in pair] == [whole_search[1]] * 2
    assert leftovers(tmp_path) == []
    assert results(tmp_path) == results(whole_search[0])
    assert (tmp_path / "other" / "ledger.jsonl").read_bytes() == (tmp_path / "run" / "ledger.jsonl").read_bytes()


@pytest.mark.parametrize(
    "depth",
    [
        pytest.param(0, id="zygote", marks=pytest.mark.slow),
        pytest.param(1, id="supervisor", marks=pytest.mark.slow),
        pytest.param(2, id="candidate", marks=pytest.mark.long),
    ],
)
def test_process_killed_from_outside_changes_nothing(depth: int, whole_search: Whole, tmp_path: Path) -> None:
    """Somebody kills a process of the sandbox: the search starts it again and goes on."""
    search = start(tmp_path, UNTRACKED)
    assert begins(Phase.evaluating, search, tmp_path)
    older = set[int]()
    assert comes(search, partial(kill_one_below, search.pid, depth, older))
    assert comes(search, lambda: bool(set(at_work_below(search.pid, depth)) - older))
    assert finish(search) == whole_search[1]
    assert results(tmp_path) == results(whole_search[0])
    assert ends(tmp_path)


def kill_one_below(pid: int, depth: int, older: set[int]) -> bool:
    """Kill a process of the sandbox that is at work, and note all that were there; False if there is none to kill."""
    before = set(descendants(pid))
    for process in at_work_below(pid, depth)[:1]:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)
            older |= {*before, process}
            return True
    return False


def at_work_below(pid: int, depth: int) -> list[int]:
    """List the processes of a search's sandbox that are at work: zygotes (0), supervisors (1) or candidates (2)."""
    processes = [pid]
    for _ in range(depth + 1):
        processes = [below for process in processes for below in children(process) if is_at_work(below)]
    return processes


def is_at_work(pid: int) -> bool:
    """Tell a process of the sandbox from other children, from one that is gone, and from one done, which stops."""
    try:
        command = Path(f"/proc/{pid}/cmdline").read_bytes()
        state = Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()[0]
    except OSError:
        return False
    return b"tacevo.sandbox.zygote" in command and state not in "TZX"


@pytest.mark.room("mlflow")
@pytest.mark.slow
def test_database_of_mlflow_that_goes_away_in_the_middle_is_a_warning(whole_search: Whole, tmp_path: Path) -> None:
    """The database is lost once the mirror has begun with it: the search is as ever, and nothing of it is lost."""
    from tacevo.tracking.mirror import alone

    search = start(tmp_path, "search.generations=3")
    assert begins(Phase.mirroring, search, tmp_path)
    for path in tmp_path.glob("mlflow.db*"):
        path.unlink()
    (tmp_path / "mlflow.db").mkdir()
    out, errors = search.communicate()
    assert search.returncode == 0, errors
    assert "MLflow mirror" in errors
    assert (
        (tmp_path / "run" / "ledger.jsonl")
        .read_bytes()
        .startswith((whole_search[0] / "run" / "ledger.jsonl").read_bytes())
    )
    with alone(tmp_path / "run"):
        pass  # the mirror has ended, for which a search waits a while only
    tacevo("track", "run", "--uri", f"sqlite:///{tmp_path}/later.db", cwd=tmp_path)
    assert mirrored(tmp_path / "later.db") == (1 + CANDIDATES + 4, out.splitlines()[-1].removeprefix("digest: "))


#: Every look at the wall clock is an hour before the one before it.
BACKWARDS = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <sys/time.h>
#include <time.h>
static _Atomic long looks;
static long back(void) { return 3600 * ++looks; }
int clock_gettime(clockid_t clock, struct timespec *now) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "clock_gettime");
    int status = real(clock, now);
    if (clock == CLOCK_REALTIME) now->tv_sec -= back();
    return status;
}
"""


@pytest.mark.room("mlflow")
@pytest.mark.slow
def test_clock_that_goes_backwards_changes_nothing(whole_search: Whole, tmp_path: Path) -> None:
    """With a wall clock that loses an hour at every look the search, its stores and its mirror are as ever."""
    if shutil.which("cc") is None:
        pytest.skip("a clock that goes backwards needs a C compiler")
    (tmp_path / "back.c").write_text(BACKWARDS)
    subprocess.run(["cc", "-shared", "-fPIC", "-o", "back.so", "back.c", "-ldl"], cwd=tmp_path, check=True)
    clock = {"LD_PRELOAD": str(tmp_path / "back.so")}
    look = "import time; a = time.time(); b = time.time(); print(a - b > 3000)"
    seen = subprocess.run([sys.executable, "-c", look], env={**os.environ, **clock}, capture_output=True, check=True)
    assert seen.stdout == b"True\n"
    assert finish(start(tmp_path, environment=clock)) == whole_search[1]
    assert results(tmp_path) == results(whole_search[0])
    assert ends(tmp_path)
    assert mirrored(tmp_path / "mlflow.db") == (1 + CANDIDATES, whole_search[1])
