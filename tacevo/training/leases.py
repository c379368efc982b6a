"""Which GPU a training runs on: each is lent to a few candidates at once (parent side)."""

import os
import threading
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from tacevo.choices import Device
from tacevo.environment import gpus
from tacevo.errors import SandboxError
from tacevo.records import Json, Limits
from tacevo.sandbox.client import Died, Finished, RunJob, Score


def visible_gpus() -> tuple[str, ...]:
    """Name the GPUs that this process may use, as CUDA_VISIBLE_DEVICES does; the machine's where that is not set."""
    named = os.environ.get("CUDA_VISIBLE_DEVICES")
    if named is None:
        return tuple(map(str, range(len(gpus()))))
    return tuple(name for name in map(str.strip, named.split(",")) if name)


def gpu_share(device: Device, per_gpu: int) -> float:
    """Return what part of a GPU a training takes, as Ray's `num_gpus` counts it, in whole 1e-4: 0 on a CPU."""
    return 0.0 if device is Device.cpu else 10_000 // per_gpu / 10_000


def leased(header: Mapping[str, Json], gpu: str, per_gpu: int) -> Json:
    """Return the header of a job that got a GPU, by its name for CUDA_VISIBLE_DEVICES."""
    return {**header, "lease": {"visible": gpu, "per_gpu": per_gpu}}


class Leases:
    """Lends GPUs to the trainings of a sandbox, the one with the fewest candidates first; others wait for their turn.

    Args:
        run: runs jobs, as `Sandbox.run` does.
        gpus: names for CUDA_VISIBLE_DEVICES.
        per_gpu: most trainings on one of them at once.
    """

    def __init__(self, run: RunJob, gpus: Sequence[str], per_gpu: int) -> None:
        self._run, self._per_gpu = run, per_gpu
        self._lent = Counter(dict.fromkeys(gpus, 0))
        self._changed = threading.Condition()

    def run(
        self, entry: str, header: Json, payload: bytes, limits: Limits, score: Score | None = None
    ) -> Finished | Died:
        """Run a job; one whose header asks for a `device` waits for a GPU first, which does not count as its time.

        Raises:
            SandboxError: as `Sandbox.run`; or a job needs a GPU, and there is none.
        """
        if not (isinstance(header, dict) and "device" in header):
            return self._run(entry, header, payload, limits, score)
        with self._lease() as gpu:
            return self._run(entry, leased(header, gpu, self._per_gpu), payload, limits, score)

    @contextmanager
    def _lease(self) -> Iterator[str]:
        if not self._lent:
            expected, remedy = "a GPU for a training", "name some in CUDA_VISIBLE_DEVICES"
            raise SandboxError("a machine without one", expected=expected, remedy=remedy)
        with self._changed:
            self._changed.wait_for(lambda: min(self._lent.values()) < self._per_gpu)
            gpu = min(self._lent, key=lambda name: self._lent[name])  # of equal ones the first that was named
            self._lent[gpu] += 1
        try:
            yield gpu
        finally:
            with self._changed:
                self._lent[gpu] -= 1
                self._changed.notify()
