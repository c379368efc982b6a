"""The executor of this machine: candidates run in processes of its own."""

import contextlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacevo.choices import Device
from tacevo.config.schema import RunConfig
from tacevo.environment import usable_cores
from tacevo.parts.executor import Notice, Order
from tacevo.sandbox.client import RunJob, Sandbox, Zygote
from tacevo.sandbox.confinement import check_confinement, in_force
from tacevo.text import counted
from tacevo.training import evaluation
from tacevo.training.numerics import check_machine

#: How many workers a core has before that is warned of.
_MOST_WORKERS = 4


@dataclass(frozen=True, slots=True)
class Local:
    """Runs candidates in sandboxes of this machine (see `tacevo.parts.executor.Executor`)."""

    def check(self, order: Order) -> None:
        """Check that candidates can be confined so here, and that this machine computes as ordered.

        Raises:
            SandboxError: they cannot be confined.
            ConfigError: it cannot compute so.
        """
        check_confinement(order.require)
        check_machine(order.numerics, order.device, order.gpu)

    def ahead(self, order: Order) -> AbstractContextManager[Zygote]:
        """Start the process that imports torch: that takes seconds."""
        return Zygote(order.entries, order.environment, equip=order.equip)

    @contextlib.contextmanager
    def open(
        self,
        order: Order,
        images: Path | None,
        *,
        started: Zygote | None = None,
        notice: Notice | None = None,
        say: Callable[[str], None] | None = None,
        predict: Callable[[Mapping[str, Any]], int | None] | None = None,
    ) -> Iterator[RunJob]:
        """Open the sandbox, and on GPUs what shares them out; nothing is said."""
        sandbox = Sandbox(
            entries=order.entries,
            environment=order.environment,
            arrays={} if images is None else {"images": images},
            strongest=order.strongest,
            doors=dict.fromkeys((*evaluation.ENTRIES, *evaluation.ENTRIES_OF_GPUS), order.doors),
            notice=None if notice is None else lambda measures: notice(in_force(measures)),
            zygote=started,
            equip=order.equip,
        )
        with sandbox:
            if order.device is Device.cpu:
                yield sandbox.run
                return
            from tacevo.training.leases import Leases, visible_gpus

            yield Leases(
                sandbox.run, visible_gpus(), order.per_gpu, predict or (lambda header: None), walled=bool(order.doors)
            ).run


def trainings_at_once(config: RunConfig) -> int:
    """Return how many trainings run here together: one for each worker, core and share of a GPU; at least one.

    Where a GPU is lent by memory, nobody knows before; then it is one for each worker, and some of them may wait.
    """
    workers, per_gpu = config.executor.workers, config.executor.per_gpu
    if config.training.device is Device.cpu:
        return max(1, min(workers, usable_cores()))
    from tacevo.training.leases import visible_gpus

    return max(1, min(workers, (workers if per_gpu is None else per_gpu) * len(visible_gpus())))


def crowded(config: RunConfig) -> list[str]:
    """Warn of many more workers than cores, a sentence; they divide the cores, and each takes memory."""
    workers, cores = config.executor.workers, usable_cores()
    if not config.executor.is_here or config.training.device is not Device.cpu or workers <= _MOST_WORKERS * cores:
        return []
    return [
        f"executor.workers={workers} on {counted(cores, 'core')}: no more than {cores} train at once; more workers "
        f"make nothing faster than executor.workers={cores}, but for waiting on a model's answers"
    ]
