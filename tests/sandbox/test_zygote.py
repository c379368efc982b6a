"""Promise: whatever is killed, zygote, supervisor, candidate or search, costs no verdict and leaves no process."""

import contextlib
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from refusals import refused
from sandboxes import ENTRIES, LIMITS, answer, open_sandbox
from waiting import eventually
from witness import is_gone

from tacevo.errors import SandboxError
from tacevo.records import Limits, Reason
from tacevo.sandbox.client import Died, Finished, Frame, Sandbox, Zygote
from tacevo.sandbox.processes import children, descendants

pytestmark = pytest.mark.timeout(60)


@pytest.fixture(scope="module")
def sandbox(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sandbox]:
    """Open one sandbox for all attacks, so that each also finds what the others left behind."""
    with open_sandbox(tmp_path_factory.mktemp("sandbox")) as opened:
        yield opened


def test_search_never_imports_torch() -> None:
    """The sandbox's client works without torch in the search process."""
    check = "import sys, tacevo.sandbox.client, tacevo.training.evaluation; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], env=_search_environment(), check=False).returncode == 0


def test_zygote_may_start_before_its_sandbox(tmp_path: Path) -> None:
    """One that was started while the data were made takes the jobs, and maps what did not exist at its start."""
    settings = {"OMP_NUM_THREADS": "1"}
    before = children(os.getpid())
    with Zygote(ENTRIES, settings) as zygote:
        np.save(tmp_path / "images.npy", np.ones((12,), np.uint8))
        begun = children(os.getpid())
        arrays = {"images": tmp_path / "images.npy"}
        with Sandbox(entries=ENTRIES, environment=settings, arrays=arrays, zygote=zygote) as fresh:
            assert fresh.run("sum_images", None, b"", LIMITS) == Finished((Frame(12, b""),))
            assert children(os.getpid()) == begun
        assert children(os.getpid()) == before


def test_zygote_that_nobody_needs_ends_at_once() -> None:
    """It is not waited for, although it still imports what nobody will use."""
    before = children(os.getpid())
    with Zygote({"probe": "tacevo.gate.probe:run"}, {"OMP_NUM_THREADS": "1"}):
        assert len(children(os.getpid())) == len(before) + 1
    assert children(os.getpid()) == before


EARLY = {"early": "killed_early:echo"}


def test_job_that_is_killed_before_its_confinement_is_no_verdict() -> None:
    """Before any of its code ran, a candidate is not to blame: it runs again; a second time the sandbox is at fault."""
    for deaths in ("1", "2"):
        with Sandbox(entries=EARLY, environment={"OMP_NUM_THREADS": "1", "KILLED_EARLY": deaths}, arrays={}) as fresh:
            if deaths == "2":
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
    """Wait until a dozing job runs below this process; return its zygote, its supervisor and its candidate."""
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


@pytest.mark.few(2)
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
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(fresh.run, "spin", None, b"", Limits(seconds=600, memory_mib=300))
        assert eventually(lambda: len(set(descendants(os.getpid())) - before) == 3)
        fresh.close()
        with refused(SandboxError, got="the sandbox was closed while a candidate ran"):
            waiting.result()
    assert set(descendants(os.getpid())) <= before
    with refused(SandboxError, got="the sandbox is closed"):
        fresh.run("echo", None, b"", LIMITS)


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
            with refused(SandboxError, got=problem):
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
