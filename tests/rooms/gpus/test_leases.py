"""Promise: no GPU is lent to more trainings than it may have, all GPUs are used, and none is lost."""

import math
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import pytest
from refusals import refused
from training_jobs import RECIPE
from waiting import eventually

from tacevo.choices import Device, Precision
from tacevo.errors import SandboxError
from tacevo.records import Gpu, Json, Limits, Reason, written
from tacevo.sandbox.client import Died, Finished, Frame
from tacevo.training.evaluation import LOOK
from tacevo.training.leases import Leases, gpu_share, visible_gpus
from tacevo.training.memory import CONTEXT_MIB

GPU = Gpu(model="NVIDIA H200", precision=Precision.float32, memory_mib=8192)
JOB: dict[str, Json] = {"device": "cuda", "seed": 0, "recipe": written(replace(RECIPE, gpu=GPU))}
#: What the job that looks at a GPU answers where this much of it is free.
FREE_MIB = 20_480


def looked(free_mib: int = FREE_MIB) -> Finished:
    """Answer as `tacevo.training.gpu.look` does."""
    return Finished((Frame({"free_mib": free_mib}, b""),))


class Busy:
    """Runs jobs that take long enough to meet; notes which GPUs were in use together."""

    def __init__(self, together: int) -> None:
        self._meeting = threading.Barrier(together)
        self._lock = threading.Lock()
        self._now: Counter[str] = Counter()
        self.most: Counter[str] = Counter()

    def run(self, entry: str, header: Any, payload: bytes, limits: Limits, *_: object) -> Finished | Died:
        """Meet the others that run."""
        if entry == LOOK:
            return looked()
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
        if entry == LOOK:
            return looked()
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


END = Frame({"weights_sha256": "0" * 64}, b"")
REJECTED = Finished((Frame({"rejection": {"reason": "out_of_memory", "detail": "CUDA out of memory"}}, b""),))


def refused_so_often(count: int) -> Finished:
    """Answer as a training that had less memory than its recipe allows."""
    return Finished((END, Frame({"refused": count}, b"")))


class Card:
    """A GPU on which jobs need memory, in MiB; a training that was lent less says so in one of the ways there are."""

    def __init__(self, needs: int, short: Finished | Died) -> None:
        self._needs, self._short = needs, short
        self.lent: list[int] = []

    def run(self, entry: str, header: Any, payload: bytes, limits: Limits, *_: object) -> Finished | Died:
        """Train with what was lent."""
        mib = header["lease"]["mib"]
        if entry == LOOK:
            return looked()
        self.lent.append(mib)
        if mib < self._needs:
            return self._short
        if mib == GPU.memory_mib:
            return Finished((END,))
        return refused_so_often(0)


@pytest.mark.parametrize(
    "short",
    [
        REJECTED,
        refused_so_often(1),
        Died(Reason.crashed, "CUDA error"),
        Died(Reason.out_of_memory, "host"),
        Finished(()),
    ],
)
def test_too_small_a_prediction_never_is_a_verdict(short: Finished | Died) -> None:
    """However a training shows that it lacked memory, it is made again with the recipe's, whose answer counts."""
    card = Card(3000, short)
    leases = Leases(card.run, ["0"], None, lambda header: 2000)
    assert leases.run("train", JOB, b"", RECIPE.limits) == Finished((END,))
    assert card.lent == [2000, GPU.memory_mib]


@pytest.mark.parametrize(("guess", "lent"), [(3000, 3000), (None, GPU.memory_mib), (90_000, GPU.memory_mib)])
def test_training_that_was_refused_nothing_is_made_once(guess: int | None, lent: int) -> None:
    """Its answer is what it would be with all of the recipe's memory; without a prediction it has that at once."""
    card = Card(3000, REJECTED)
    assert Leases(card.run, ["0"], None, lambda _: guess).run("train", JOB, b"", RECIPE.limits) == Finished((END,))
    assert card.lent == [lent]


def test_training_beyond_the_recipes_memory_ends_as_it_says() -> None:
    """With all of it there is no other attempt: its own verdict stands. Nor is there one after the time is out."""
    card = Card(9000, REJECTED)
    assert Leases(card.run, ["0"], None, lambda _: 2000).run("train", JOB, b"", RECIPE.limits) == REJECTED
    assert card.lent == [2000, GPU.memory_mib]
    late = Died(Reason.out_of_time, "ran for more than 1 s")
    card = Card(9000, late)
    assert Leases(card.run, ["0"], None, lambda _: 2000).run("train", JOB, b"", RECIPE.limits) == late
    assert card.lent == [2000]


class Filled:
    """A GPU that notes the most memory that was lent at once; jobs wait for each other where they can."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._now = self.most = 0
        self.order: list[int] = []
        self.go = threading.Event()

    def run(self, entry: str, header: Any, payload: bytes, limits: Limits, *_: object) -> Finished | Died:
        """Hold what was lent until the others have come."""
        if entry == LOOK:
            return looked()
        size = header["lease"]["mib"] + CONTEXT_MIB
        with self._lock:
            self.order.append(header["seed"])
            self._now += size
            self.most = max(self.most, self._now)
        self.go.wait(20)
        with self._lock:
            self._now -= size
        return refused_so_often(0)


def test_no_more_is_lent_than_a_gpu_has() -> None:
    """Of trainings of 4 GiB with the driver's part five fit into 20 GiB, and never six."""
    filled = Filled()
    leases = Leases(filled.run, ["0"], None, lambda _: 4096 - CONTEXT_MIB)
    with ThreadPoolExecutor(12) as pool:
        futures = [pool.submit(leases.run, "train", {**JOB, "seed": seed}, b"", RECIPE.limits) for seed in range(12)]
        assert eventually(lambda: len(filled.order) == 5)
        filled.go.set()
        assert all(future.result() == Finished((END,)) for future in futures)
    assert filled.most == FREE_MIB


def test_large_training_is_not_passed_by_small_ones() -> None:
    """Who came first has its turn first, also where a later one would fit at once."""
    filled, guesses = Filled(), {0: 8000, 1: 8000, 2: 8000, 3: 500}
    leases = Leases(filled.run, ["0"], None, lambda header: guesses[header["seed"]])
    with ThreadPoolExecutor(4) as pool:
        for seed in guesses:
            pool.submit(leases.run, "train", {**JOB, "seed": seed}, b"", RECIPE.limits)
            assert eventually(lambda seed=seed: len(filled.order) >= min(seed + 1, 2))  # type: ignore[misc]
            time.sleep(0.05)  # so that it waits before the next one comes
        assert filled.order == [0, 1]  # 3 would fit beside them
        filled.go.set()
    assert filled.order == [0, 1, 2, 3]


@pytest.mark.parametrize("per_gpu", [None, 2])
@pytest.mark.parametrize(
    ("answer", "got"),
    [
        (Finished((Frame({"failed": "RuntimeError: Operation not permitted"}, b""),)), "Operation not permitted"),
        (Died(Reason.crashed, "killed by signal 31"), "killed by signal 31"),
        (Finished(()), "another answer"),
        (None, "CUDA error"),
    ],
)
def test_gpu_that_does_not_compute_stops_the_search_before_a_candidate_runs(
    per_gpu: int | None, answer: Finished | Died | None, got: str
) -> None:
    """As behind walls that its driver does not bear: no candidate is blamed for it."""
    entries = []

    def run(entry: str, *_: object) -> Finished | Died:
        entries.append(entry)
        if answer is None:
            raise SandboxError("RuntimeError: CUDA error", expected="a sandbox that works")
        return answer

    with refused(SandboxError, got=got, remedy="sandbox.require=none"):
        Leases(run, ["3"], per_gpu).run("train", JOB, b"", RECIPE.limits)
    assert entries == [LOOK]


def test_gpu_without_room_for_one_training_is_refused() -> None:
    """A training that may need all of its recipe's memory would wait for ever."""
    leases = Leases(lambda *_: looked(9000), ["0"], None, lambda _: 500)
    expected, remedy = f"{GPU.memory_mib + CONTEXT_MIB} MiB free on each GPU", "lower training.gpu_memory_mib"
    with refused(SandboxError, expected=expected, got="9000 MiB", remedy=remedy):
        leases.run("train", JOB, b"", RECIPE.limits)
