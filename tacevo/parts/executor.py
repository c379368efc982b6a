"""Executors, which run candidates in sandboxes: what `executor.kind` chooses."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from tacevo.choices import Confinement, Device, Numerics

if TYPE_CHECKING:
    from tacevo.sandbox.client import RunJob

#: Called with what confined a candidate, as `tacevo.sandbox.confinement.in_force` names it, before its answer is used.
Notice = Callable[[Mapping[str, str]], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """The demands of a run on each machine that runs candidates; it goes to all of them, and holds no key."""

    #: The functions that a sandbox runs, by entry name.
    entries: Mapping[str, str]
    #: The function that it calls before it confines a candidate; None for nothing.
    equip: str | None
    #: The variables of a candidate's process that decide its results.
    environment: Mapping[str, str]
    numerics: Numerics
    device: Device
    #: The model of the GPU; None for any, or on a CPU.
    gpu: str | None
    #: The most trainings on one GPU at once; None for as many as fit, on this machine.
    per_gpu: int | None
    #: The weakest confinement that will do.
    require: Confinement
    #: Patterns of the device files that the walls leave open to what computes on a GPU.
    doors: tuple[str, ...] = ()

    @property
    def strongest(self) -> Confinement:
        """The strongest confinement of a candidate on this device: on a GPU all of it or none, as is demanded."""
        is_walled = self.device is Device.cpu or self.require is Confinement.kernel
        return Confinement.kernel if is_walled else Confinement.none


class Executor(Protocol):
    """Runs candidates here or elsewhere, to the same bytes: what `executor.kind=NAME` stands for.

    An executor of your own is a frozen dataclass. A field that has the name of a setting of `executor` (`workers`,
    `per_gpu`, `address`) gets that setting; each other field is a setting of its own, `parts.NAME.FIELD`.
    """

    def check(self, order: Order) -> None:
        """Check, before anything is made, that candidates can run as ordered.

        Raises:
            ConfigError: a library, a cluster or a device is missing.
            SandboxError: candidates cannot be confined so.
        """
        ...

    def ahead(self, order: Order) -> AbstractContextManager[Any]:
        """Start what takes long to start, while the data are loaded; what it yields is the `started` of `open`."""
        ...

    def open(
        self,
        order: Order,
        images: Path | None,
        *,
        started: Any = None,
        notice: Notice | None = None,
        say: Callable[[str], None] | None = None,
        predict: Callable[[Mapping[str, Any]], int | None] | None = None,
    ) -> AbstractContextManager[RunJob]:
        """Open what runs jobs as `tacevo.sandbox.client.Sandbox.run` does; several threads may call that at once.

        Args:
            order: what each machine must do.
            images: the file of all images of the data set, uint8 of shape (N, 3, size, size); None where nothing is
                trained.
            started: of `ahead`; None where that was not called.
            notice: called for every candidate before its answer is returned, by the thread that waits for it.
            say: called with a line for the user.
            predict: returns the memory that a training takes of a GPU, in MiB, by the header of its job; None where
                nobody knows.
        """
        ...
