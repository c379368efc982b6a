"""Promise: a job hears of each frame whether its score is the lowest so far, and what scores it costs it nothing."""

import os
import signal
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from sandboxes import LIMITS, open_sandbox
from waiting import eventually

from tacevo.choices import Confinement
from tacevo.records import Json
from tacevo.sandbox.client import Finished, Sandbox, Score
from tacevo.sandbox.processes import descendants

pytestmark = pytest.mark.timeout(60)


@pytest.fixture(scope="module")
def sandbox(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sandbox]:
    """Open one sandbox, with every wall that this machine has."""
    with open_sandbox(tmp_path_factory.mktemp("sandbox"), Confinement.kernel) as opened:
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


def test_frames_that_nobody_waits_for_do_no_harm(tmp_path: Path) -> None:
    """A hostile job that does not look at what it is told, and may look for its pipe; nothing of it is left."""
    with open_sandbox(tmp_path) as sandbox:
        assert heard(sandbox, ["1"]) == [True]
        before = set(descendants(os.getpid()))
        finished = sandbox.run("send_without_waiting", None, b"", LIMITS, lambda _, payload: len(payload))
        assert isinstance(finished, Finished)
        assert len(finished.frames) == 500
        assert eventually(lambda: before.issuperset(descendants(os.getpid())))
        assert heard(sandbox, ["1"]) == [True]
