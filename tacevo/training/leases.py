"""The lease of a GPU to a training, with a part of its memory: each is lent to several at once (parent side)."""

import os
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from tacevo.choices import Device
from tacevo.environment import gpus
from tacevo.errors import SandboxError
from tacevo.records import Json, Limits, Reason, Recipe
from tacevo.sandbox.client import Died, Finished, RunJob, Score
from tacevo.training.evaluation import LOOK
from tacevo.training.memory import CONTEXT_MIB

#: The most that this job may take, in MiB.
_LOOK_MIB = 512

_IF_IT_FAILS = "see docs/scale.md#gpus; with sandbox.require=kernel, try sandbox.require=none, for code that you trust"

#: Predicts the memory that a training takes, in MiB, from the header of its job; None where nothing is known of it.
Predict = Callable[[Mapping[str, Any]], int | None]


def visible_gpus() -> tuple[str, ...]:
    """Name the GPUs that this process may use, as CUDA_VISIBLE_DEVICES does; the machine's where that is not set."""
    named = os.environ.get("CUDA_VISIBLE_DEVICES")
    if named is None:
        return tuple(map(str, range(len(gpus()))))
    return tuple(name for name in map(str.strip, named.split(",")) if name)


def gpu_share(device: Device, per_gpu: int | None) -> float:
    """Return what part of a GPU a training takes, as Ray's `num_gpus` counts it, in whole 1e-4: 0 on a CPU."""
    return 0.0 if device is Device.cpu else 10_000 // (per_gpu or 1) / 10_000


def leased(header: Mapping[str, Json], gpu: str, *, per_gpu: int | None = None, mib: int | None = None) -> Json:
    """Return the header of a job that got a GPU, by its name for CUDA_VISIBLE_DEVICES.

    `per_gpu` says with how many it shares the GPU, each of which may have the memory of the recipe; or `mib` how much
    memory it has.
    """
    how: dict[str, Json] = {"per_gpu": per_gpu or 1} if mib is None else {"mib": mib}
    return {**header, "lease": {"visible": gpu, **how}}


class Leases:
    """Lends GPUs to the trainings of a sandbox, the one with the most room first; others wait in the order they came.

    With a number, so many share a GPU. Without one, memory is lent: as many train as fit by what is predicted, and no
    process can take more than it was lent, so that none disturbs another. What a training does under less than its
    recipe's memory counts only where it ended well and nothing was refused it. Otherwise it is made again with all of
    that, so that a verdict does not follow from a prediction, nor from what ran beside it; only `out_of_time` stands.
    Even where torch goes on without the memory, with a convolution that needs less, bits are those that the recipe
    gives.

    Args:
        run: runs jobs, as `Sandbox.run` does; it has the entry `LOOK`.
        gpus: names for CUDA_VISIBLE_DEVICES.
        per_gpu: most trainings on one of them at once; None for as many as fit.
        predict: what a training will take; used where `per_gpu` is None.
        walled: whether walls hold what runs there.
    """

    def __init__(
        self,
        run: RunJob,
        gpus: Sequence[str],
        per_gpu: int | None,
        predict: Predict = lambda header: None,
        *,
        walled: bool = False,
    ) -> None:
        self._run, self._gpus, self._per_gpu, self._predict = run, tuple(gpus), per_gpu, predict
        self._walled = walled
        #: Places, or MiB, that are not lent. None before the GPUs were looked at.
        self._room: dict[str, int] | None = None
        self._looking = threading.Lock()
        self._waiting: deque[object] = deque()
        self._changed = threading.Condition()

    def run(
        self, entry: str, header: Json, payload: bytes, limits: Limits, score: Score | None = None
    ) -> Finished | Died:
        """Run a job; one whose header asks for a `device` waits for a GPU first, which does not count as its time.

        Raises:
            SandboxError: as `Sandbox.run`; or a job needs a GPU, and there is none, or none that suffices.
        """
        if not (isinstance(header, dict) and "device" in header):
            return self._run(entry, header, payload, limits, score)
        self._look(header, limits)
        if self._per_gpu is not None:
            with self._lease(1) as gpu:
                return self._run(entry, leased(header, gpu, per_gpu=self._per_gpu), payload, limits, score)
        most = _most(header)
        for mib in sorted({min(most, self._predict(header) or most), most}):
            with self._lease(mib + CONTEXT_MIB) as gpu:
                outcome = self._run(entry, leased(header, gpu, mib=mib), payload, limits, score)
            if mib == most or (isinstance(outcome, Died) and outcome.reason is Reason.out_of_time):
                break
            if (sufficed := _sufficed(outcome)) is not None:
                return sufficed
        return outcome

    def _look(self, header: Mapping[str, Any], limits: Limits) -> None:
        """Try each GPU once, before the first training: what it cannot do is no candidate's doing.

        Raises:
            SandboxError: there is none; or one does not compute behind the walls that are asked for, or is too small.
        """
        with self._looking:
            if self._room is not None:
                return
            if not self._gpus:
                expected, remedy = "a GPU for a training", "name some in CUDA_VISIBLE_DEVICES"
                raise SandboxError("a machine without one", expected=expected, remedy=remedy)
            asked = {"recipe": header["recipe"], "device": header["device"], "walled": self._walled}
            free = {gpu: self._look_at(gpu, leased(asked, gpu, mib=_LOOK_MIB), limits) for gpu in self._gpus}
            if self._per_gpu is None and min(free.values()) < (needed := _most(header) + CONTEXT_MIB):
                expected = f"{needed} MiB free on each GPU for a candidate"
                remedy = "lower training.gpu_memory_mib, or end what else uses the GPU"
                raise SandboxError(f"{min(free.values())} MiB", expected=expected, remedy=remedy)
            self._room = free if self._per_gpu is None else dict.fromkeys(self._gpus, self._per_gpu)

    def _look_at(self, gpu: str, header: Json, limits: Limits) -> int:
        """Return what is free of a GPU, in MiB."""
        try:
            return _free_mib(self._run(LOOK, header, b"", limits), gpu)
        except SandboxError as error:  # such as that of a driver that did not start
            error.remedy = error.remedy or _IF_IT_FAILS
            raise

    @contextmanager
    def _lease(self, size: int) -> Iterator[str]:
        assert self._room is not None  # since it was looked at them
        room, ticket = self._room, object()
        with self._changed:
            self._waiting.append(ticket)
            try:  # in order, so that a large one is not passed by small ones for ever
                self._changed.wait_for(lambda: self._waiting[0] is ticket and max(room.values()) >= size)
                gpu = max(room, key=lambda name: room[name])  # of equal ones the first that was named
                room[gpu] -= size
            finally:
                self._waiting.remove(ticket)
                self._changed.notify_all()
        try:
            yield gpu
        finally:
            with self._changed:
                room[gpu] += size
                self._changed.notify_all()


def _most(header: Mapping[str, Any]) -> int:
    """Return the memory that a training's recipe allows, in MiB.

    Raises:
        SandboxError: it is not one of a GPU.
    """
    gpu = Recipe.from_json(header["recipe"]).gpu
    if gpu is None:
        raise SandboxError("a recipe for a CPU", expected="the GPU that the training is to have")
    return gpu.memory_mib


def _sufficed(outcome: Finished | Died) -> Finished | None:
    """Return a training's answer without its last frame, if that says that no memory was refused; else None."""
    if isinstance(outcome, Finished) and outcome.frames and outcome.frames[-1].header == {"refused": 0}:
        return Finished(outcome.frames[:-1], outcome.cpu_seconds)
    return None


def _free_mib(outcome: Finished | Died, gpu: str) -> int:
    """Read what `tacevo.training.gpu.look` answered: the memory that was free before it, in MiB.

    Raises:
        SandboxError: it failed.
    """
    match outcome:
        case Finished(frames=(frame,)) if isinstance(frame.header, dict):
            if isinstance(free := frame.header.get("free_mib"), int):
                return free
            detail = str(frame.header.get("failed", "another answer"))
        case Died(detail=detail):
            pass
        case _:
            detail = "another answer"
    raise SandboxError(detail, place=f"GPU {gpu}", expected="a small computation that succeeds there")
