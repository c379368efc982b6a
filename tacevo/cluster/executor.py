"""The executor of a Ray cluster: candidates run on its nodes."""

import contextlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacevo.cluster.cluster import Cluster
from tacevo.cluster.connection import check_head, import_ray
from tacevo.cluster.node_images import describe
from tacevo.parts.executor import Notice, Order
from tacevo.sandbox.client import RunJob


@dataclass(frozen=True, slots=True, kw_only=True)
class Ray:
    """Runs candidates on the nodes of a Ray cluster (see `tacevo.parts.executor.Executor`)."""

    #: The address of the cluster's head, as HOST:PORT, or `auto`; None to start a Ray here.
    address: str | None
    #: Jobs at once, which is the number of slots of a Ray that is started.
    workers: int

    def check(self, order: Order) -> None:
        """Check that Ray is installed and answers at its address; a node is checked when it joins.

        Raises:
            ConfigError: it is not, or does not.
        """
        import_ray(self.address)
        if self.address is not None:
            check_head(self.address)

    def ahead(self, order: Order) -> AbstractContextManager[None]:
        """Start nothing: nodes start what they need."""
        return contextlib.nullcontext()

    @contextlib.contextmanager
    def open(
        self,
        order: Order,
        images: Path | None,
        *,
        started: None = None,
        notice: Notice | None = None,
        say: Callable[[str], None] | None = None,
        predict: Callable[[Mapping[str, Any]], int | None] | None = None,
    ) -> Iterator[RunJob]:
        """Join the nodes; raises as `tacevo.cluster.cluster.Cluster`."""
        described = None if images is None else (describe(images), images)
        with Cluster(order, described, address=self.address, workers=self.workers, notice=notice, say=say) as cluster:
            yield cluster.run
