"""Promise: a job hears of each frame whether its score is the lowest so far, and what scores it costs it nothing."""

import os
import signal
import socket
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sandboxes import ENTRIES, LIMITS, open_sandbox
from waiting import eventually

from tacevo.choices import Confinement, Numerics
from tacevo.records import Json, Reason, to_json
from tacevo.sandbox.client import Died, Finished, Sandbox, Score, Zygote
from tacevo.sandbox.processes import descendants
from tacevo.sandbox.protocol import Channel, Message, Sort
from tacevo.training.numerics import environment

pytestmark = pytest.mark.timeout(60)


@pytest.fixture(scope="module")
def sandbox(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sandbox]:
    """Open one sandbox, with every wall that this machine has."""
    with open_sandbox(tmp_path_factory.mktemp("sandbox"), Confinement.kernel) as opened:
        yield opened


@pytest.fixture(scope="module")
def open_one(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sandbox]:
    """Open one in which a hostile job can find its pipe."""
    with open_sandbox(tmp_path_factory.mktemp("open")) as opened:
        yield opened


def number(_: int, payload: bytes) -> float:
    """Score a payload by the number that it is, the end of a job by none."""
    return float("inf") if payload == b"end" else float(payload)


def heard(sandbox: Sandbox, scores: list[str], score: Score | None = number) -> Json:
    """Return what a job heard of its frames."""
    finished = sandbox.run("hear", scores, b"", LIMITS, score)
    assert isinstance(finished, Finished), finished
    assert [frame.payload for frame in finished.frames] == [*(text.encode() for text in scores), b"end"]
    return finished.frames[-1].header


def test_lowest_so_far_is_told(sandbox: Sandbox) -> None:
    """A tie, infinity and NaN are not lower; a job that is not scored hears nothing."""
    assert heard(sandbox, ["3", "2", "2", "inf", "nan", "1"]) == [True, True, False, False, False, True]
    assert heard(sandbox, ["3", "2"], None) == [None, None]


def test_time_of_the_score_is_not_the_candidates(sandbox: Sandbox) -> None:
    """A search that is slow, or was stopped by its user, does not make a candidate too slow."""

    def slow(_: int, payload: bytes) -> float:
        time.sleep(0.6)
        return number(0, payload)

    assert isinstance(sandbox.run("hear", ["3", "2"], b"", replace(LIMITS, seconds=1), slow), Finished)


def test_job_that_runs_again_hears_of_its_own_frames_alone(sandbox: Sandbox) -> None:
    """One that was killed from outside begins anew; so do its scores."""
    before: set[int] = set(descendants(os.getpid()))
    killed: list[int] = []

    def kill_once(_: int, payload: bytes) -> float:
        if payload == b"2" and not killed:
            killed.extend(set(descendants(os.getpid())) - before)
            os.kill(killed[-1], signal.SIGKILL)
        return number(0, payload)

    assert heard(sandbox, ["3", "2"], kill_once) == [True, True]
    assert killed


@pytest.mark.slow
def test_frames_that_nobody_waits_for_do_no_harm(open_one: Sandbox) -> None:
    """A hostile job that does not look at what it is told; nothing of it is left."""
    assert heard(open_one, ["1"]) == [True]
    before = set(descendants(os.getpid()))
    finished = open_one.run("send_without_waiting", None, b"", LIMITS, lambda _, payload: len(payload))
    assert isinstance(finished, Finished)
    assert len(finished.frames) == 500
    assert eventually(lambda: before.issuperset(descendants(os.getpid())))
    assert heard(open_one, ["1"]) == [True]


def test_frames_after_the_end_are_not_scored(open_one: Sandbox) -> None:
    """Nothing is read of a job that has said that it is done."""
    asked: list[int] = []

    def score(number: int, _: bytes) -> float:
        asked.append(number)
        return 0.0

    finished = open_one.run("send_after_the_end", None, b"", LIMITS, score)
    assert isinstance(finished, Finished)
    assert (len(finished.frames), asked) == (2, [0, 1])


@pytest.mark.parametrize(
    ("job", "reason"),
    [("fill_memory_while_scored", Reason.out_of_memory), ("spin_while_scored", Reason.out_of_time)],
)
def test_limits_hold_while_a_frame_is_scored(job: str, reason: Reason, open_one: Sandbox) -> None:
    """However long that takes: the candidate is dead before its frame has a score, and the verdict is about it."""
    assert heard(open_one, ["1"]) == [True]
    before = {*descendants(os.getpid())}
    dead: list[bool] = []

    def score(_: int, payload: bytes) -> float:
        dead.append(eventually(lambda: before.issuperset(descendants(os.getpid()))))
        return 0.0

    outcome = open_one.run(job, None, b"", replace(LIMITS, seconds=1), score)
    assert isinstance(outcome, Died), outcome
    assert outcome.reason is reason
    assert dead == [True]


@pytest.mark.slow
def test_time_of_children_that_are_lost_counts(open_one: Sandbox) -> None:
    """What a killed child computed is not given to its parent again: 2 s are enough for six children of 0.3 s."""
    asked: list[int] = []

    def slow(number: int, _: bytes) -> float:
        asked.append(number)
        time.sleep(0.2)
        return 0.0

    outcome = open_one.run("lose_children_while_scored", None, b"", replace(LIMITS, seconds=2), slow)
    assert isinstance(outcome, Died), outcome
    assert outcome.reason is Reason.out_of_time
    assert len(asked) <= 6


@pytest.mark.slow
def test_limits_hold_while_nobody_reads(tmp_path: Path) -> None:
    """A search that stands still, with a frame half sent; it reads the frame and the verdict when it goes on."""
    np.save(tmp_path / "images.npy", np.ones(12, np.uint8))
    ours, theirs = socket.socketpair()
    with ours, Zygote(ENTRIES, environment(Numerics.portable)) as zygote:
        with theirs:
            zygote.submit(theirs, {"images": tmp_path / "images.npy"})
        channel = Channel(ours)
        supervisor = channel.receive().read_header()["pid"]
        order: dict[str, Json] = {
            "entry": "fill_memory_while_scored",
            "header": None,
            "limits": to_json(LIMITS),
            "scored": True,
        }
        order |= {"strongest": Confinement.process, "answer_bytes": 2**26, "prepared": False}
        channel.send(Message.of(Sort.job, order))
        assert eventually(lambda: [*descendants(supervisor)] != [])
        assert eventually(lambda: [*descendants(supervisor)] == [])
        frame, verdict = channel.receive(), channel.receive()
    assert (frame.sort, len(frame.header)) == (Sort.frame, 3 * 2**18 + 3)
    assert verdict.read_header()["reason"] == Reason.out_of_memory
