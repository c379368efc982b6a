"""Promise: whatever a candidate does, the search gets a typed answer, and no process of the candidate's is left.

All of it holds without the kernel's walls, which these tests leave out; test_walls.py puts them up.
"""

import os
import signal
import tempfile
import tracemalloc
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sandboxes import ENTRIES, LIMITS, answer, open_sandbox
from waiting import eventually
from witness import is_gone, living, watching_candidates

from tacevo.choices import Confinement
from tacevo.records import Limits, Reason
from tacevo.sandbox.client import Died, Finished, Frame, Sandbox
from tacevo.sandbox.processes import children, descendants
from tacevo.sandbox.protocol import Message, Sort

pytestmark = pytest.mark.timeout(60)

SHORT = replace(LIMITS, seconds=1)


@pytest.fixture(scope="module")
def sandbox(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sandbox]:
    """Open one sandbox for all attacks, so that each also finds what the others left behind."""
    with open_sandbox(tmp_path_factory.mktemp("sandbox")) as opened:
        yield opened


@contextmanager
def holding_little_memory(mib: int) -> Iterator[None]:
    """See that this process, the search, never holds more than so many MiB beside what it had."""
    tracemalloc.start()
    try:
        yield
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < mib * 2**20


def death(sandbox: Sandbox, entry: str, limits: Limits = LIMITS, payload: bytes = b"") -> Died:
    """Run an attack that must die, and see that nothing of it is left and the sandbox still works."""
    assert sandbox.run("echo", 0, b"", LIMITS) == Finished((Frame(0, b""),))  # whoever comes first starts the zygote
    before = set(descendants(os.getpid()))
    answer = sandbox.run(entry, None, payload, limits)
    assert isinstance(answer, Died)
    assert eventually(lambda: before.issuperset(descendants(os.getpid())))
    assert sandbox.run("echo", 1, b"", LIMITS) == Finished((Frame(1, b""),))
    return answer


JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(header=JSON, payload=st.binary(max_size=300_000))
def test_header_and_payload_pass_through_unchanged(sandbox: Sandbox, header: Any, payload: bytes) -> None:
    """What an entry gets and sends is what was meant."""
    assert sandbox.run("echo", header, payload, LIMITS) == Finished((Frame(header, payload),))


def test_threads_get_their_own_answers(sandbox: Sandbox) -> None:
    """Jobs of several threads at once are not mixed up."""
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(lambda number: answer(sandbox, "echo", number), range(24)))
    assert answers == list(range(24))


def test_child_sees_a_cleared_environment(sandbox: Sandbox, monkeypatch: pytest.MonkeyPatch) -> None:
    """No variable of the search reaches a candidate, and two sandboxes give a text the same hash."""
    monkeypatch.setenv("ANTHROPIC_API_KEY", "secret")
    settings = {"OMP_NUM_THREADS": "1"}
    with Sandbox(entries=ENTRIES, environment=settings, arrays={}, strongest=Confinement.process) as fresh:
        seen = answer(fresh, "look_around")
    seen["environment"].pop("LC_CTYPE", None)  # which Python sets itself
    assert seen["environment"] == {"OMP_NUM_THREADS": "1", "PYTHONHASHSEED": "0"}
    assert seen["hash"] == answer(sandbox, "look_around")["hash"]  # no candidate's bits depend on it


def test_child_has_its_own_session_and_no_inherited_file(sandbox: Sandbox) -> None:
    """A candidate stands alone: a session, a neutral directory, silent streams, one pipe."""
    seen = answer(sandbox, "look_around")
    assert seen["is_session_leader"]
    assert seen["directory"] == "/"
    assert seen["streams"] == ["/dev/null"] * 3
    assert seen["descriptors"] == 4


def test_arrays_are_shared_read_only(sandbox: Sandbox) -> None:
    """A candidate reads the images and cannot change them."""
    assert answer(sandbox, "sum_images") == 12


@pytest.mark.parametrize("entry", ["spin", "spin_with_family"])
def test_endless_candidate_is_gone_when_its_verdict_comes(sandbox: Sandbox, entry: str) -> None:
    """The search hears of a limit only after the whole tree has been killed and reaped, other sessions included."""
    with watching_candidates() as seen:
        died = sandbox.run(entry, None, b"", SHORT)
        left = living(seen)
    assert died == Died(Reason.out_of_time, "ran for more than 1 s")
    assert len(seen) >= (5 if entry == "spin_with_family" else 1)
    assert left == []
    assert answer(sandbox, "echo", 1) == 1


def test_orphan_of_a_finished_candidate_is_killed(sandbox: Sandbox) -> None:
    """A grandchild that left the session does not outlive the answer."""
    orphan = answer(sandbox, "leave_an_orphan")
    assert eventually(lambda: is_gone(orphan))


@pytest.mark.parametrize("entry", ["spin_in_finaliser", "spin_at_exit"])
def test_endless_end_does_not_delay_the_answer(sandbox: Sandbox, entry: str) -> None:
    """After the answer nothing of the candidate's runs, so its finalisers cannot hold it up."""
    assert answer(sandbox, entry) == "answered"


def test_short_peak_of_memory_counts(sandbox: Sandbox) -> None:
    """Memory that is given back before anybody looks is found by the kernel's own record."""
    detail = "used more than 16 MiB of resident memory"
    assert death(sandbox, "flash_memory", replace(LIMITS, memory_mib=16)) == Died(Reason.out_of_memory, detail)


@pytest.fixture
def folder_in_memory() -> Iterator[Path]:
    """Make a directory whose files have no disk."""
    memory = Path("/dev/shm")
    if not os.access(memory, os.W_OK):
        pytest.skip("no file system in memory that this user may write to")
    with tempfile.TemporaryDirectory(dir=memory) as folder:
        yield Path(folder)


@pytest.mark.parametrize("place", ["on a disk", "in memory"])
def test_memory_of_mapped_images_is_free(place: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """Images that are read through a mapping are shared by all candidates, and do not count, wherever they lie."""
    folder = tmp_path if place == "on a disk" else request.getfixturevalue("folder_in_memory")
    np.save(folder / "images.npy", np.ones((40 * 2**20,), np.uint8))
    arrays = {"images": folder / "images.npy"}
    with Sandbox(entries=ENTRIES, environment={"OMP_NUM_THREADS": "1"}, arrays=arrays) as fresh:
        finished = fresh.run("sum_images", None, b"", replace(LIMITS, memory_mib=16))
    assert finished == Finished((Frame(40 * 2**20, b""),))


@pytest.mark.parametrize(
    "entry",
    [
        "reserve_two_gib",
        "fill_shared_memory",
        "fill_memory_in_family",
        "fill_memory_without_leader",
        "fill_memory_in_fork_without_leader",
    ],
)
def test_greedy_candidate_is_out_of_memory(sandbox: Sandbox, entry: str) -> None:
    """Memory counts in one piece, when shared, over all processes of the tree, and whichever threads have ended."""
    assert death(sandbox, entry).reason is Reason.out_of_memory


@pytest.mark.parametrize(
    ("entry", "detail"),
    [
        ("exit_quietly", "it exited with status 0 before it had answered"),
        ("raise_system_exit", "SystemExit: 0"),
        ("divide_by_zero", "ZeroDivisionError: division by zero"),
        ("read_address_zero", "killed by signal 11"),
        ("kill_supervisor", "its supervisor was killed"),
        ("kill_itself", "killed by signal 9"),
        ("close_pipe", "it closed its result pipe"),
        ("close_pipe_while_traced", "it closed its result pipe"),
    ],
)
def test_death_without_an_answer_is_a_crash(sandbox: Sandbox, entry: str, detail: str) -> None:
    """Every way to end without a full answer is a verdict, not a hang and not an exception."""
    assert death(sandbox, entry) == Died(Reason.crashed, detail)


def test_silence_of_a_process_that_lives_is_told_at_once(sandbox: Sandbox) -> None:
    """A closed pipe ends the job long before its limit, although the first thread looks dead."""
    patient = replace(LIMITS, seconds=600)
    assert death(sandbox, "close_pipe_without_leader", patient) == Died(Reason.crashed, "it closed its result pipe")


@pytest.mark.parametrize(
    ("entry", "payload", "limits", "reason"),
    [
        pytest.param("answer_much", b"", LIMITS, Reason.too_much_output, id="endless"),
        pytest.param(
            "write_raw", b"\x05\x00\x00\x00\x00" + b"\xff" * 8, LIMITS, Reason.too_much_output, id="announced endless"
        ),
        pytest.param(
            "write_raw",
            Message.of(Sort.frame, None, bytes(100)).to_bytes()[:50],
            SHORT,
            Reason.out_of_time,
            id="half a message",
        ),
    ],
)
def test_answer_without_an_end_is_not_waited_for(
    sandbox: Sandbox, entry: str, payload: bytes, limits: Limits, reason: Reason
) -> None:
    """The search collects and awaits no more than a stated number of bytes, and no longer than the limit."""
    assert death(sandbox, entry, limits, payload).reason is reason


def test_sandbox_may_bound_its_answers_otherwise(tmp_path: Path) -> None:
    """A file of several networks is larger than any other answer."""
    with open_sandbox(tmp_path, answer_bytes=100_000) as narrow:
        assert narrow.run("echo", 0, b"0" * 50_000, LIMITS) == Finished((Frame(0, b"0" * 50_000),))
        too_much = narrow.run("echo", 0, b"0" * 110_000, LIMITS)
    assert isinstance(too_much, Died)
    assert too_much.reason is Reason.too_much_output


@pytest.mark.parametrize(
    ("entry", "detail"),
    [
        ("announce_lists", "expected at most 2097152 bytes of headers; got more"),
        ("send_crumbs", "expected at most 10000 messages; got more"),
    ],
)
def test_answer_that_would_swell_in_the_search_is_too_much_output(sandbox: Sandbox, entry: str, detail: str) -> None:
    """Headers and messages are counted before they are read: 64 MiB of either are a GiB to a reader that keeps them."""
    with holding_little_memory(32):
        assert death(sandbox, entry) == Died(Reason.too_much_output, detail)


def test_endless_last_words_are_cut_before_they_reach_the_search(sandbox: Sandbox) -> None:
    """The text of an error is one line, independent of its author."""
    with holding_little_memory(32):
        died = death(sandbox, "raise_at_length", replace(LIMITS, seconds=60))  # a machine may be slow
    assert died == Died(Reason.crashed, "\N{REPLACEMENT CHARACTER}" * 300)


@pytest.mark.slow
def test_longest_header_costs_little_memory(sandbox: Sandbox) -> None:
    """What is just allowed is read, and takes no more than a training does."""
    with holding_little_memory(200):
        assert len(answer(sandbox, "send_lists_that_fit")) == 699_001


DONE = Message.of(Sort.done, None).to_bytes()
FORGED = {
    "ready once more": Message.of(Sort.ready, ["nothing"]).to_bytes() + DONE,
    "unknown sort": b"\xff" * 13,
    "message of another role": Message.of(Sort.verdict, {"ended": "finished"}).to_bytes(),
} | {
    name: Message(Sort.frame, header, b"").to_bytes() + DONE
    for name, header in {
        "no JSON": b"{",
        "NaN": b"NaN",
        "infinity": b"1e999",
        "lone surrogate": b'"\\ud800"',
        "bad UTF-8": b'"\xff"',
        "deep nesting": b"[" * 100_000,
        "endless number": b"9" * 100_000,
    }.items()
}


@pytest.mark.parametrize("forged", FORGED.values(), ids=FORGED.keys())
def test_garbage_in_the_pipe_is_a_crash(sandbox: Sandbox, forged: bytes) -> None:
    """A candidate that writes to the result pipe itself gets a verdict, whatever it writes."""
    assert death(sandbox, "write_raw", payload=forged).reason is Reason.crashed


@pytest.mark.slow
def test_stopped_supervisor_does_not_stop_the_search(sandbox: Sandbox) -> None:
    """Where a candidate stops its supervisor, the search itself ends both."""
    assert death(sandbox, "stop_supervisor", SHORT).detail == "ran for more than 1 s, and its supervisor was stopped"


def test_prints_go_nowhere(sandbox: Sandbox, capfd: pytest.CaptureFixture[str]) -> None:
    """A candidate may print megabytes; nobody is held up and nothing is shown."""
    assert answer(sandbox, "print_much") == "answered"
    assert capfd.readouterr() == ("", "")


def test_nothing_can_be_opened_or_read(sandbox: Sandbox) -> None:
    """No file, socket, pipe or program is added, and labels and keys in memory are out of reach, for root's, too."""
    assert answer(sandbox, "open_things") == []
    assert answer(sandbox, "steal", {"search": os.getpid()}) == []


def test_no_byte_can_be_written(sandbox: Sandbox, tmp_path: Path) -> None:
    """A candidate adds no byte to any file."""
    (tmp_path / "old").touch()
    answer(sandbox, "write_files", {"folder": str(tmp_path)})
    assert all(path.stat().st_size == 0 for path in tmp_path.iterdir())


def test_missing_entry_is_named(sandbox: Sandbox) -> None:
    """A misspelt entry is the caller's mistake, told at once."""
    with pytest.raises(KeyError, match="got 'ecko'"):
        sandbox.run("ecko", None, b"", LIMITS)


def test_zygote_that_does_not_answer_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stopped one hears no order; it and all below it are killed."""
    monkeypatch.setattr("tacevo.sandbox.client._GRACE_SECONDS", 0.1)
    before = set(children(os.getpid()))
    with open_sandbox(tmp_path) as opened:
        assert opened.run("echo", 0, b"", LIMITS) == Finished((Frame(0, b""),))
        (zygote,) = set(children(os.getpid())) - before
        os.kill(zygote, signal.SIGSTOP)
    assert is_gone(zygote)


def test_processor_time_is_measured_from_outside(sandbox: Sandbox) -> None:
    """What spins until its limit took more of it than what answers at once, and could not say less."""
    idle = sandbox.run("echo", 0, b"", LIMITS)
    busy = sandbox.run("spin", None, b"", SHORT)
    assert 0 <= idle.cpu_seconds < busy.cpu_seconds
