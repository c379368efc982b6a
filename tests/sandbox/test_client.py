"""Promise: whatever a candidate does, the search gets a typed answer, and no process of the candidate's is left.

All of it holds without the kernel's walls, which these tests leave out; test_walls.py puts them up.
"""

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
import tracemalloc
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import attacks
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import refused
from waiting import eventually
from witness import is_gone, living, watching_candidates

from tacevo.choices import Confinement, Numerics
from tacevo.errors import SandboxError
from tacevo.records import Limits, Reason
from tacevo.sandbox.client import Died, Finished, Frame, Sandbox, Zygote
from tacevo.sandbox.processes import children, descendants
from tacevo.sandbox.protocol import Message, Sort
from tacevo.training.numerics import environment

pytestmark = pytest.mark.timeout(60)

LIMITS = Limits(seconds=5, memory_mib=300)
SHORT = Limits(seconds=1, memory_mib=300)
ENTRIES = {
    name: f"attacks:{name}"
    for name, value in vars(attacks).items()
    if callable(value) and value.__module__ == "attacks"
}


def open_sandbox(folder: Path) -> Sandbox:
    """Open a sandbox with every attack and 12 bytes of images, with the measures that need no special kernel."""
    images = folder / "images.npy"
    np.save(images, np.ones((12,), np.uint8))
    return Sandbox(
        entries=ENTRIES,
        environment=environment(Numerics.portable),
        arrays={"images": images},
        strongest=Confinement.process,
    )


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


def answer(sandbox: Sandbox, entry: str, header: Any = None) -> Any:
    """Run an attack that must answer with one frame; give its header."""
    finished = sandbox.run(entry, header, b"", LIMITS)
    assert isinstance(finished, Finished), finished
    (frame,) = finished.frames
    return frame.header


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


def test_child_sees_a_cleared_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """No variable of the search reaches a candidate."""
    monkeypatch.setenv("ANTHROPIC_API_KEY", "secret")
    settings = {"OMP_NUM_THREADS": "1"}
    with Sandbox(entries=ENTRIES, environment=settings, arrays={}, strongest=Confinement.process) as fresh:
        seen = answer(fresh, "look_around")["environment"]
    seen.pop("LC_CTYPE", None)  # which Python sets itself
    assert seen == {"OMP_NUM_THREADS": "1", "PYTHONHASHSEED": "0"}


def test_child_has_its_own_session_and_no_inherited_file(sandbox: Sandbox) -> None:
    """A candidate stands alone: a session, a neutral directory, silent streams, one pipe."""
    seen = answer(sandbox, "look_around")
    assert seen["is_session_leader"]
    assert seen["directory"] == "/"
    assert seen["streams"] == ["/dev/null"] * 3
    assert seen["descriptors"] == 4


def test_hashes_of_text_are_fixed(sandbox: Sandbox, tmp_path: Path) -> None:
    """Two sandboxes give a string the same hash, so that no candidate's bits depend on it."""
    with open_sandbox(tmp_path) as other:
        assert answer(other, "look_around")["hash"] == answer(sandbox, "look_around")["hash"]


def test_arrays_are_shared_read_only(sandbox: Sandbox) -> None:
    """A candidate reads the images and cannot change them."""
    assert answer(sandbox, "sum_images") == 12


def test_search_never_imports_torch() -> None:
    """The sandbox's client works without torch in the search process."""
    check = "import sys, tacevo.sandbox.client, tacevo.training.evaluation; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], env=_search_environment(), check=False).returncode == 0


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
    little = Limits(seconds=5, memory_mib=16)
    assert death(sandbox, "flash_memory", little) == Died(
        Reason.out_of_memory, "used more than 16 MiB of resident memory"
    )


def test_memory_of_mapped_images_is_free(tmp_path: Path) -> None:
    """Images that are read through a mapping are shared by all candidates, and do not count."""
    np.save(tmp_path / "images.npy", np.ones((40 * 2**20,), np.uint8))
    arrays = {"images": tmp_path / "images.npy"}
    with Sandbox(entries=ENTRIES, environment={"OMP_NUM_THREADS": "1"}, arrays=arrays) as fresh:
        finished = fresh.run("sum_images", None, b"", Limits(seconds=5, memory_mib=16))
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
    patient = Limits(seconds=600, memory_mib=300)
    assert death(sandbox, "close_pipe_without_leader", patient) == Died(Reason.crashed, "it closed its result pipe")


def test_zygote_may_start_before_its_sandbox(tmp_path: Path) -> None:
    """One that was started while the data were made takes the jobs, and maps what did not exist at its start."""
    settings = {"OMP_NUM_THREADS": "1"}
    with Zygote(ENTRIES, settings) as zygote:
        np.save(tmp_path / "images.npy", np.ones((12,), np.uint8))
        begun = children(os.getpid())
        arrays = {"images": tmp_path / "images.npy"}
        with Sandbox(entries=ENTRIES, environment=settings, arrays=arrays, zygote=zygote) as fresh:
            assert fresh.run("sum_images", None, b"", LIMITS) == Finished((Frame(12, b""),))
            assert children(os.getpid()) == begun
        assert not zygote.is_alive()


def test_zygote_that_nobody_needs_ends_at_once() -> None:
    """It is not waited for, although it still imports what nobody will use."""
    before = children(os.getpid())
    with Zygote({"probe": "tacevo.gate.probe:run"}, {"OMP_NUM_THREADS": "1"}) as zygote:
        assert zygote.is_alive()
    assert not zygote.is_alive()
    assert children(os.getpid()) == before


EARLY = {"early": "killed_early:echo"}


def test_job_that_was_killed_before_its_confinement_is_run_again() -> None:
    """Before any of its code ran, a candidate's death is none of its doing."""
    with Sandbox(entries=EARLY, environment={"OMP_NUM_THREADS": "1", "KILLED_EARLY": "1"}, arrays={}) as fresh:
        assert fresh.run("early", 1, b"", LIMITS) == Finished((Frame(1, b""),))


def test_job_that_is_killed_twice_before_its_confinement_is_no_verdict() -> None:
    """Where it happens again the sandbox is at fault, says so, and can be used again."""
    with Sandbox(entries=EARLY, environment={"OMP_NUM_THREADS": "1", "KILLED_EARLY": "2"}, arrays={}) as fresh:
        with refused(SandboxError, expected="a child that is confined", got="killed by signal 9"):
            fresh.run("early", 1, b"", LIMITS)
        assert fresh.run("early", 1, b"", LIMITS) == Finished((Frame(1, b""),))


CROWDED_SEARCH = """
import os, resource, socket
from tacevo.choices import Confinement
from tacevo.errors import SandboxError
from tacevo.records import Limits
from tacevo.sandbox.client import Sandbox
from tacevo.sandbox.kernel import drop_capabilities
from tacevo.sandbox.processes import children
limits = Limits(seconds=60, memory_mib=300)
entries = {"echo": "attacks:echo"}
with Sandbox(entries=entries, environment={"OMP_NUM_THREADS": "1"}, arrays={}) as sandbox:
    sandbox.run("echo", None, b"", limits)
    zygotes = children(os.getpid())
    drop_capabilities()  # root may have any number of files on their way
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
    ours, theirs = socket.socketpair()
    try:
        while True:
            socket.send_fds(ours, [b"x"], [0] * 50)
    except OSError:
        pass
    try:
        sandbox.run("echo", None, b"", limits)
    except SandboxError as error:
        print(error)
    ours.close(), theirs.close()
    sandbox.run("echo", None, b"", limits)
    print(children(os.getpid()) == zygotes)
"""


def test_socket_that_the_kernel_does_not_pass_on_costs_no_zygote() -> None:
    """Too many files on their way stop one job, not the zygote, and so none of those that run."""
    command = [sys.executable, "-c", CROWDED_SEARCH]
    done = subprocess.run(command, env=_search_environment(), check=True, capture_output=True, text=True)
    assert re.fullmatch(r"expected a kernel that passes jobs on; got .*Too many references.*; .*\nTrue\n", done.stdout)


def is_of_a_sandbox(pid: int) -> bool:
    """Tell a sandbox's processes from others that a test session starts, such as multiprocessing's tracker."""
    try:
        return b"tacevo.sandbox" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


def wait_for_doze() -> list[int]:
    """Wait until a dozing job runs below this process; give its zygote, its supervisor and its candidate."""
    family: list[int] = []

    def dozes() -> bool:
        family[:] = [pid for pid in descendants(os.getpid()) if is_of_a_sandbox(pid)]
        return len(family) == 3 and os.getpriority(os.PRIO_PROCESS, family[-1]) > os.getpriority(os.PRIO_PROCESS, 0)

    assert eventually(dozes)
    return family


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_signal_that_cancels_a_run_is_no_verdict(sandbox: Sandbox, number: signal.Signals) -> None:
    """A batch system that signals every process does not make a running candidate look broken."""
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(answer, sandbox, "doze")
        for pid in wait_for_doze():
            os.kill(pid, number)
        assert waiting.result() == "answered"


@pytest.mark.parametrize(
    "members", [(1,), (2,), (0, 1), (0, 1, 2)], ids=["supervisor", "candidate", "both above it", "all"]
)
def test_job_that_was_killed_once_is_run_again(sandbox: Sandbox, members: tuple[int, ...]) -> None:
    """The kernel's way out of full memory is not a verdict on a candidate, and nothing of it lives on."""
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(answer, sandbox, "doze")
        family = wait_for_doze()
        for member in members:
            os.kill(family[member], signal.SIGKILL)
        assert eventually(lambda: not is_of_a_sandbox(family[2]))  # a zombie has no command line
        assert waiting.result() == "answered"


def test_endless_answer_is_too_much_output(sandbox: Sandbox) -> None:
    """The search does not collect more than a stated number of bytes."""
    assert death(sandbox, "answer_much").reason is Reason.too_much_output


def test_announced_endless_answer_is_too_much_output(sandbox: Sandbox) -> None:
    """The search does not wait for more than a stated number of bytes either."""
    announced = b"\x05\x00\x00\x00\x00\xff\xff\xff\xff\xff\xff\xff\xff"
    assert death(sandbox, "write_raw", payload=announced).reason is Reason.too_much_output


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
        assert death(sandbox, "raise_at_length") == Died(Reason.crashed, "\N{REPLACEMENT CHARACTER}" * 300)


def test_longest_header_costs_little_memory(sandbox: Sandbox) -> None:
    """What is just allowed is read, and takes no more than a training does."""
    with holding_little_memory(200):
        assert len(answer(sandbox, "send_lists_that_fit")) == 699_001


FORGED = {
    "ready once more": Message.of(Sort.ready, ["nothing"]).to_bytes() + Message.of(Sort.done, None).to_bytes(),
    "unknown sort": b"\xff" * 13,
    "message of another role": Message.of(Sort.verdict, {"ended": "finished"}).to_bytes(),
    "no JSON": Message(Sort.frame, b"{", b"").to_bytes() + Message.of(Sort.done, None).to_bytes(),
    "NaN": Message(Sort.frame, b"NaN", b"").to_bytes() + Message.of(Sort.done, None).to_bytes(),
    "infinity": Message(Sort.frame, b"1e999", b"").to_bytes() + Message.of(Sort.done, None).to_bytes(),
    "lone surrogate": Message(Sort.frame, b'"\\ud800"', b"").to_bytes() + Message.of(Sort.done, None).to_bytes(),
    "bad UTF-8": Message(Sort.frame, b'"\xff"', b"").to_bytes() + Message.of(Sort.done, None).to_bytes(),
    "deep nesting": Message(Sort.frame, b"[" * 100_000, b"").to_bytes() + Message.of(Sort.done, None).to_bytes(),
    "endless number": Message(Sort.frame, b"9" * 100_000, b"").to_bytes() + Message.of(Sort.done, None).to_bytes(),
}


@pytest.mark.parametrize("forged", FORGED.values(), ids=FORGED.keys())
def test_garbage_in_the_pipe_is_a_crash(sandbox: Sandbox, forged: bytes) -> None:
    """A candidate that writes to the result pipe itself gets a verdict, whatever it writes."""
    assert death(sandbox, "write_raw", payload=forged).reason is Reason.crashed


def test_half_a_message_is_out_of_time(sandbox: Sandbox) -> None:
    """The search does not wait longer than the limit for the rest of a message."""
    half = Message.of(Sort.frame, None, bytes(100)).to_bytes()[:50]
    assert death(sandbox, "write_raw", SHORT, half).reason is Reason.out_of_time


def test_stopped_supervisor_does_not_stop_the_search(sandbox: Sandbox) -> None:
    """Where a candidate stops its supervisor, the search itself ends both."""
    assert death(sandbox, "stop_supervisor", SHORT).detail == "ran for more than 1 s, and its supervisor was stopped"


def test_killed_zygote_costs_no_running_job(tmp_path: Path) -> None:
    """A job outlives the zygote, and the next job starts another one."""
    before = set(children(os.getpid()))
    with open_sandbox(tmp_path) as fresh:
        answer(fresh, "echo")
        (zygote,) = set(children(os.getpid())) - before
        assert answer(fresh, "kill_zygote", zygote) == "answered"
        assert answer(fresh, "echo", 2) == 2


def test_candidate_that_kills_supervisor_and_zygote_is_a_crash(tmp_path: Path) -> None:
    """A second time it is the candidate's doing, not the sandbox's fault, and the next job starts another zygote."""
    with open_sandbox(tmp_path) as fresh:
        killed = fresh.run("kill_supervisor_and_zygote", None, b"", LIMITS)
        assert killed == Died(Reason.crashed, "its supervisor was killed")
        assert answer(fresh, "echo", 2) == 2


def test_prints_go_nowhere(sandbox: Sandbox, capfd: pytest.CaptureFixture[str]) -> None:
    """A candidate may print megabytes; nobody is held up and nothing is shown."""
    assert answer(sandbox, "print_much") == "answered"
    assert capfd.readouterr() == ("", "")


def test_memory_of_the_search_cannot_be_read(sandbox: Sandbox) -> None:
    """Labels and keys in the memory of search and supervisor are out of reach, for root's candidates too."""
    assert answer(sandbox, "steal", {"search": os.getpid()}) == []


def test_nothing_can_be_opened(sandbox: Sandbox) -> None:
    """No file, socket or pipe is added to those that a candidate starts with, and no program is started."""
    assert answer(sandbox, "open_things") == []


def test_no_byte_can_be_written(sandbox: Sandbox, tmp_path: Path) -> None:
    """A candidate adds no byte to any file."""
    (tmp_path / "old").touch()
    answer(sandbox, "write_files", {"folder": str(tmp_path)})
    assert all(path.stat().st_size == 0 for path in tmp_path.iterdir())


def _search_environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


HANGING_SEARCH = """
import attacks
from tacevo.choices import Confinement
from tacevo.records import Limits
from tacevo.sandbox.client import Sandbox
with Sandbox(
    entries={"hang": "attacks:spin_with_family"},
    environment={"OMP_NUM_THREADS": "1"},
    arrays={},
    strongest=Confinement.process,
) as sandbox:
    sandbox.run("hang", None, b"", Limits(seconds=600, memory_mib=300))
"""


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_ended_search_leaves_no_orphan(end: signal.Signals) -> None:
    """However the search ends, its zygote, its supervisors and its candidates end too."""
    command = [sys.executable, "-c", HANGING_SEARCH]
    with subprocess.Popen(command, env=_search_environment(), stderr=subprocess.DEVNULL) as search:
        try:
            assert eventually(lambda: len(list(descendants(search.pid))) >= 7)  # zygote, supervisor, five of the attack
            family = list(descendants(search.pid))
        finally:
            search.send_signal(end)
    assert eventually(lambda: all(map(is_gone, family)))


def test_closed_sandbox_ends_running_jobs(tmp_path: Path) -> None:
    """Closing does not wait for candidates; a thread that waits for one is told."""
    fresh = open_sandbox(tmp_path)
    before = set(descendants(os.getpid()))
    told: list[SandboxError] = []

    def wait_for_it() -> None:
        try:
            fresh.run("spin", None, b"", Limits(seconds=600, memory_mib=300))
        except SandboxError as error:
            told.append(error)

    waiting = threading.Thread(target=wait_for_it)
    waiting.start()
    assert eventually(lambda: len(set(descendants(os.getpid())) - before) == 3)
    fresh.close()
    waiting.join()
    assert len(told) == 1
    assert set(descendants(os.getpid())) <= before
    with refused(SandboxError, got="the sandbox is closed"):
        fresh.run("echo", None, b"", LIMITS)


def test_missing_entry_is_named(sandbox: Sandbox) -> None:
    """A misspelt entry is the caller's mistake, told at once."""
    with pytest.raises(KeyError, match="got 'ecko'"):
        sandbox.run("ecko", None, b"", LIMITS)


@pytest.mark.parametrize(
    ("entries", "arrays", "problem"),
    [
        ({"a": "nowhere:run"}, {}, "No module named 'nowhere'"),
        ({"a": "attacks:nothing"}, {}, "has no attribute 'nothing'"),
        ({"a": "attacks:echo"}, {"images": Path("/nowhere.npy")}, "No such file"),
    ],
)
def test_zygote_that_cannot_be_prepared_says_why(
    entries: dict[str, str], arrays: dict[str, Path], problem: str
) -> None:
    """A broken sandbox raises, with the same reason for every job; it never judges a candidate."""
    with Sandbox(entries=entries, environment={"OMP_NUM_THREADS": "1"}, arrays=arrays) as broken:
        for _ in range(2):
            with refused(SandboxError, expected="imports its entries", got=problem):
                broken.run("a", None, b"", LIMITS)


def test_zygote_that_was_started_early_and_killed_is_replaced() -> None:
    """The job that meets it is answered by another one."""
    entries, environment = {"echo": "attacks:echo"}, {"OMP_NUM_THREADS": "1"}
    before = set(children(os.getpid()))
    early = Zygote(entries, environment)
    with Sandbox(entries=entries, environment=environment, arrays={}, zygote=early) as own:
        (zygote,) = set(children(os.getpid())) - before
        os.kill(zygote, signal.SIGKILL)
        with contextlib.suppress(SandboxError):
            own.run("echo", 0, b"", LIMITS)
        assert own.run("echo", 1, b"", LIMITS) == Finished((Frame(1, b""),))


def test_zygote_that_dies_at_its_start_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The last line that the process wrote is in the error."""
    (tmp_path / "fatal.py").write_text("import os\nos.write(2, b'at first\\nlast words\\n\\n')\nos._exit(3)\n")
    monkeypatch.syspath_prepend(tmp_path)
    with (
        Sandbox(entries={"a": "fatal:run"}, environment={"OMP_NUM_THREADS": "1"}, arrays={}) as broken,
        refused(SandboxError, expected="a zygote that starts", got="; it wrote: last words"),
    ):
        broken.run("a", None, b"", LIMITS)
