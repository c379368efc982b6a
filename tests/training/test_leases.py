"""Promise: no GPU is lent to more trainings than it may have, all GPUs are used, and none is lost."""

import math
import threading
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from refusals import refused
from training_jobs import RECIPE

from tacevo.choices import Device
from tacevo.errors import SandboxError
from tacevo.records import Json, Limits
from tacevo.sandbox.client import Died, Finished
from tacevo.training.leases import Leases, gpu_share, visible_gpus

JOB: Json = {"device": "cuda", "seed": 0}


class Busy:
    """Runs jobs that take long enough to meet; notes which GPUs were in use together."""

    def __init__(self, together: int) -> None:
        self._meeting = threading.Barrier(together)
        self._lock = threading.Lock()
        self._now: Counter[str] = Counter()
        self.most: Counter[str] = Counter()

    def run(self, entry: str, header: Any, payload: bytes, limits: Limits, *_: object) -> Finished | Died:
        """Meet the others that run."""
        gpu = header["lease"]["visible"]
        with self._lock:
            self._now[gpu] += 1
            self.most |= self._now
        self._meeting.wait(20)
        with self._lock:
            self._now[gpu] -= 1
        return Finished(())


def test_trainings_spread_over_all_gpus_and_never_crowd_one() -> None:
    """Twelve trainings by six threads on three GPUs of two: six run at once, two on each."""
    busy = Busy(together=6)
    leases = Leases(busy.run, ["0", "1", "2"], 2)
    with ThreadPoolExecutor(12) as pool:
        assert list(pool.map(lambda _: leases.run("train", JOB, b"", RECIPE.limits), range(12))) == [Finished(())] * 12
    assert busy.most == {"0": 2, "1": 2, "2": 2}


def test_lease_that_failed_is_given_back() -> None:
    """A broken sandbox, or a stop, must not leave a GPU lent for ever."""

    def fail(entry: str, header: Any, payload: bytes, limits: Limits, *_: object) -> Finished:
        raise SandboxError("broken")

    leases = Leases(fail, ["GPU-1234"], 1)
    for _ in range(3):
        with pytest.raises(SandboxError, match="broken"):
            leases.run("train", JOB, b"", RECIPE.limits)


def test_job_without_a_device_needs_no_gpu() -> None:
    """A probe runs on the CPU, as it was sent, also where every GPU is lent; a training without any is refused."""
    sent = []

    def note(entry: str, header: Any, payload: bytes, limits: Limits, *_: object) -> Finished:
        sent.append(header)
        return Finished(())

    leases = Leases(note, [], 1)
    leases.run("probe", {"source": "x"}, b"", RECIPE.limits)
    assert sent == [{"source": "x"}]
    with refused(
        SandboxError, expected="a GPU for a training", got="a machine without one", remedy="CUDA_VISIBLE_DEVICES"
    ):
        leases.run("train", JOB, b"", RECIPE.limits)


def test_gpus_are_those_that_the_user_may_see(monkeypatch: pytest.MonkeyPatch) -> None:
    """A batch system names some of a machine's, in any of CUDA's spellings; an empty name hides all."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3, MIG-12,GPU-ab")
    assert visible_gpus() == ("3", "MIG-12", "GPU-ab")
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    assert visible_gpus() == ()


def test_share_of_a_gpu_is_what_ray_counts() -> None:
    """Four candidates on one GPU take a quarter of it each; one on a CPU takes none."""
    assert (gpu_share(Device.cuda, 4), gpu_share(Device.cuda, 1), gpu_share(Device.cpu, 4)) == (0.25, 1.0, 0.0)
    for many in (3, 6, 7):  # Ray counts in 1e-4, and may round up
        assert many * math.ceil(gpu_share(Device.cuda, many) * 10_000) <= 10_000
