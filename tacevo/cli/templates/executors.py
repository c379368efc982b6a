"""Executors: where candidates are checked and trained."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacevo.parts.executor import Executor, Notice, Order
from tacevo.runs.local import Local
from tacevo.sandbox.client import RunJob


@dataclass(frozen=True)
class Mine(Executor):
    """Runs candidates in sandboxes of this machine, and says so."""

    #: How many candidates there are at once; a search sets it by `executor.workers`.
    workers: int = 1

    def check(self, order: Order) -> None:
        """Check, before anything is made, that candidates can run as ordered."""
        Local().check(order)

    def ahead(self, order: Order) -> AbstractContextManager[Any]:
        """Start what takes long to start."""
        return Local().ahead(order)

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
        """Open what runs a job; several threads call that at once."""
        if say is not None:
            say(f"candidates run here, {self.workers} at once")
        return Local().open(order, images, started=started, notice=notice, say=say, predict=predict)
