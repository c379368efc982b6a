"""Promise: a device is made ready before a job's process is confined, and its failure is never a verdict."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
from refusals import refused

from tacevo.choices import Confinement
from tacevo.errors import SandboxError
from tacevo.records import Json, Limits, Reason
from tacevo.sandbox import client
from tacevo.sandbox.client import Died, Finished, Frame, Sandbox
from tacevo.sandbox.protocol import Message, Sort

LIMITS = Limits(seconds=20, memory_mib=300)
ENTRIES = {"write_raw": "attacks:write_raw"} | {
    name: f"equipping:{name}" for name in ("tell", "rest", "stop_supervisor_later")
}
SETTINGS = {"OMP_NUM_THREADS": "1"}

pytestmark = pytest.mark.timeout(60)


@pytest.fixture(scope="module")
def sandbox() -> Iterator[Sandbox]:
    """Open a sandbox with a device and no walls, as on a GPU, whose zygote has started."""
    with Sandbox(
        entries=ENTRIES, environment=SETTINGS, arrays={}, equip="equipping:equip", strongest=Confinement.none
    ) as opened:
        opened.run("tell", None, b"", LIMITS)
        yield opened


def test_device_is_made_ready_before_the_walls_and_its_failure_says_nothing_of_a_candidate() -> None:
    """What `equip` returns reaches the entry, which is confined; a job that it fails for raises, and others run."""
    with Sandbox(entries=ENTRIES, environment=SETTINGS, arrays={}, equip="equipping:equip") as sandbox:
        assert sandbox.run("tell", None, b"", LIMITS) == Finished((Frame(["Name:", True], b""),))
        with refused(SandboxError, expected="a sandbox that works", got="RuntimeError: CUDA error: out of memory"):
            sandbox.run("tell", "fail", b"", LIMITS)
        assert sandbox.run("tell", None, b"", LIMITS) == Finished((Frame(["Name:", True], b""),))


@pytest.mark.parametrize(
    ("header", "limits", "got"),
    [
        ({"seconds": 60}, replace(LIMITS, seconds=1), "ran for more than 1 s"),
        ({"mib": 400}, LIMITS, "used more than 300 MiB"),
    ],
)
def test_device_that_takes_too_much_is_no_verdict(sandbox: Sandbox, header: Json, limits: Limits, got: str) -> None:
    """Time and memory that go before a line of the candidate has run are not its own."""
    with refused(SandboxError, expected="a sandbox that works", got=f"what makes a device ready {got}"):
        sandbox.run("tell", header, b"", limits)


def test_stopped_supervisor_of_a_device_is_no_verdict(sandbox: Sandbox, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor is it one where nobody says in time that the candidate runs."""
    monkeypatch.setattr(client, "_GRACE_SECONDS", -19.0)
    with refused(SandboxError, expected="a device that is ready", got="none after 1 s"):
        sandbox.run("tell", {"seconds": 60}, b"", LIMITS)


@pytest.mark.slow
def test_time_of_a_candidate_begins_when_its_device_is_ready(sandbox: Sandbox, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of both takes less than the limit, and together they take more than supervisor and search wait for one."""
    monkeypatch.setattr(client, "_GRACE_SECONDS", 0.5)
    assert sandbox.run("rest", {"seconds": 2}, b"", replace(LIMITS, seconds=3)) == Finished(())


@pytest.mark.slow
def test_candidate_cannot_begin_its_time_again(sandbox: Sandbox, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another word that it is ready ends it; without its supervisor the search's own limit does."""
    again = Message.of(Sort.ready, []).to_bytes()
    assert sandbox.run("write_raw", None, again, LIMITS) == Died(Reason.crashed, "it sent a message of sort ready")
    monkeypatch.setattr(client, "_GRACE_SECONDS", 0.5)
    answer = sandbox.run("stop_supervisor_later", None, b"", replace(LIMITS, seconds=2))
    assert answer == Died(Reason.out_of_time, "ran for more than 2 s, and its supervisor was stopped")
