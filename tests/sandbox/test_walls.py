"""Promise: behind the kernel's walls a candidate computes and answers, and everything else is refused by the kernel.

Where an attack names what it tries, it is also seen to work without the walls.
"""

import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from sandboxes import ENTRIES, LIMITS, answer, open_sandbox
from waiting import eventually

from tacevo.choices import Confinement
from tacevo.records import Reason
from tacevo.sandbox.client import Died, Finished, Frame, Sandbox
from tacevo.sandbox.confinement import available, in_force
from tacevo.sandbox.processes import descendants

pytestmark = [
    pytest.mark.timeout(60),
    pytest.mark.skipif(available() is not Confinement.kernel, reason="the kernel has no Landlock or no seccomp"),
]

SHORT, PATIENT = replace(LIMITS, seconds=1), replace(LIMITS, seconds=50)

#: Calls that newer kernels let pass every filter (uretprobe, uprobe); made by other code than the kernel's own, they
#: kill the process.
PROBES = {"x86_64": (335, 336)}


@pytest.fixture(scope="module")
def walled(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sandbox]:
    """Open one sandbox with the kernel's walls for all attacks."""
    with open_sandbox(tmp_path_factory.mktemp("walled"), Confinement.kernel) as opened:
        yield opened


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sandbox]:
    """Open one sandbox without them."""
    with open_sandbox(tmp_path_factory.mktemp("plain"), Confinement.process) as opened:
        yield opened


def folder_with_files(folder: Path) -> Path:
    """Make a directory with what the attacks on names change."""
    folder.mkdir()
    for name in ("file", "victim", "doomed"):
        (folder / name).write_text("content")
    (folder / "old mark").symlink_to("an old message")
    return folder


def state(folder: Path) -> list[tuple[object, ...]]:
    """Return all that the attacks could have changed in a directory."""
    statuses = {path.name: path.lstat() for path in sorted(folder.iterdir())}
    return [(name, seen.st_mode, seen.st_ino, seen.st_mtime_ns, seen.st_size) for name, seen in statuses.items()]


def test_no_name_or_mode_in_the_file_system_changes(walled: Sandbox, plain: Sandbox, tmp_path: Path) -> None:
    """What needs no open file is refused too: directories, links, modes, times, attributes, removal."""
    open_folder, guarded = folder_with_files(tmp_path / "open"), folder_with_files(tmp_path / "guarded")
    before = state(guarded)
    worked = answer(plain, "attempt_names", {"folder": str(open_folder), "marked": True})
    refused = answer(walled, "attempt_names", {"folder": str(guarded), "marked": False})
    assert set(worked.values()) <= {"worked", "ENOTSUP"}  # some file systems have no extended attributes
    assert set(refused.values()) == {"EPERM"}
    assert state(guarded) == before


def test_no_process_is_started_or_reached(walled: Sandbox, plain: Sandbox) -> None:
    """There are no children, threads and programs, hence no races with the kill; nobody outside is signalled."""
    refused = answer(walled, "attempt_processes", {"search": os.getpid()})
    assert refused.pop("thread") == "EAGAIN"
    assert set(refused.values()) == {"EPERM"}
    worked = answer(plain, "attempt_processes", {"search": os.getpid()})
    reached = {"fork", "thread", "signal", "signal to the supervisor", "signal to all", "limits of others", "session"}
    assert {name for name, outcome in worked.items() if outcome == "worked"} >= reached
    assert worked["exec"] == "ENOENT"


def test_no_message_is_left_for_another_candidate(walled: Sandbox, plain: Sandbox) -> None:
    """What System V keeps beyond a process cannot be made."""
    assert set(answer(plain, "attempt_channels").values()) == {"worked"}
    assert set(answer(walled, "attempt_channels").values()) == {"EPERM"}


def test_every_unlisted_system_call_is_refused(walled: Sandbox) -> None:
    """The kernel itself answers EPERM to every number that is in no list: rings, tracing, namespaces, all to come."""
    header = {"machine": platform.machine(), "below": 1024, "spared": PROBES.get(platform.machine(), ())}
    report = answer(walled, "attempt_every_number", header)
    assert report["tried"] > 1900
    assert report["through"] == []


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the machine code is that of x86")
def test_calls_of_32_bits_are_refused(walled: Sandbox, plain: Sandbox) -> None:
    """The old way into the kernel, where the numbers mean other calls, is shut."""
    works = answer(plain, "call_as_another_architecture")
    if works["returned"] != works["pid"]:
        pytest.skip("the kernel has no 32-bit calls")
    assert answer(walled, "call_as_another_architecture")["returned"] == -1


def test_nothing_of_the_search_can_be_read(walled: Sandbox) -> None:
    """Memory and environment of search and supervisor, files, sockets, pipes and programs are out of reach."""
    assert answer(walled, "steal", {"search": os.getpid()}) == []
    assert answer(walled, "open_things") == []


def test_images_are_read_and_not_changed(walled: Sandbox) -> None:
    """The walls leave what was mapped before they went up."""
    assert answer(walled, "sum_images") == 12


@pytest.mark.slow
def test_module_that_was_not_imported_before_is_missing(walled: Sandbox, plain: Sandbox) -> None:
    """An import that comes too late fails alike at each level, as an import."""
    name = next(module for module in ("tabnanny", "sndhdr", "chunk") if module not in sys.modules)
    assert answer(walled, "import_more", name) == answer(plain, "import_more", name) == f"No module named '{name}'"


@pytest.mark.parametrize("strongest", list(Confinement))
@pytest.mark.parametrize("entry", ["echo", "divide_by_zero"])
def test_what_held_a_candidate_is_told_with_its_answer(strongest: Confinement, entry: str) -> None:
    """Whoever opens a sandbox learns what was in force in the process itself, however it ended."""
    told: list[tuple[str, ...]] = []
    with Sandbox(
        entries=ENTRIES, environment={"OMP_NUM_THREADS": "1"}, arrays={}, strongest=strongest, notice=told.append
    ) as fresh:
        fresh.run(entry, None, b"", LIMITS)
    (measures,) = told
    assert in_force(measures)["level"] == strongest


def test_signals_to_itself_work(walled: Sandbox) -> None:
    """Libraries that signal themselves go on as usual, and a failed assertion of theirs has its own verdict."""
    assert answer(walled, "handle_own_signal") == "handled"
    assert walled.run("abort", None, b"", LIMITS) == Died(Reason.crashed, "killed by signal 6")


@pytest.mark.parametrize(
    ("entry", "verdict"),
    [
        ("spin", Died(Reason.out_of_time, "ran for more than 1 s")),
        ("exit_quietly", Died(Reason.crashed, "it exited with status 0 before it had answered")),
        ("read_address_zero", Died(Reason.crashed, "killed by signal 11")),
        ("fill_shared_memory", Died(Reason.out_of_memory, "used more than 300 MiB of resident memory")),
        ("spin_with_family", Died(Reason.crashed, "PermissionError: [Errno 1] Operation not permitted")),
        ("kill_supervisor", Died(Reason.crashed, "PermissionError: [Errno 1] Operation not permitted")),
        ("stop_supervisor", Died(Reason.crashed, "PermissionError: [Errno 1] Operation not permitted")),
    ],
)
def test_verdicts_come_through_the_walls(walled: Sandbox, entry: str, verdict: Died) -> None:
    """Each way to end has its verdict, nothing is left of it, and the next job is answered."""
    assert walled.run("echo", 0, b"", LIMITS) == Finished((Frame(0, b""),))  # whoever comes first starts the zygote
    before = set(descendants(os.getpid()))
    limits = SHORT if verdict.reason is Reason.out_of_time else PATIENT
    assert walled.run(entry, None, b"", limits) == verdict
    assert walled.run("echo", 1, b"", LIMITS) == Finished((Frame(1, b""),))
    assert eventually(lambda: before.issuperset(descendants(os.getpid())))


@pytest.mark.parametrize("entry", ["spin_in_finaliser", "spin_at_exit", "print_much"])
def test_answers_come_through_the_walls(walled: Sandbox, entry: str) -> None:
    """What does not harm does not matter."""
    assert answer(walled, entry) == "answered"
