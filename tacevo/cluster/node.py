"""A node's process: one sandbox for all slots of the node, with the images mapped from a directory of its own."""

import pickle
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tacevo.cluster import node_images as files
from tacevo.cluster.node_images import Images
from tacevo.cluster.node_report import Facts, facts_here
from tacevo.environment import machine
from tacevo.errors import SandboxError
from tacevo.parts.executor import Order
from tacevo.sandbox.client import Sandbox, Zygote
from tacevo.sandbox.confinement import in_force
from tacevo.training.leases import leased


class ClusterNode:
    """The process of one run on one node; Ray starts it, and starts it again where it was killed.

    `images` is None where nothing is trained.
    """

    def __init__(self, order: Order, images: Images | None) -> None:
        self._order, self._images = order, images
        self._lock = threading.Lock()
        self._zygote: Zygote | None = None
        self._opened: Sandbox | None = None
        #: The measures that confined the candidate that each thread waits for.
        self._held = threading.local()

    def look(self) -> Facts:
        """Find out whether this node computes what the search would; nothing is started yet."""
        return facts_here(self._order)

    def prepare(self) -> bool:
        """Start the sandbox; tell whether the images are here."""
        order = self._order
        self._zygote = Zygote(order.entries, order.environment, equip=order.equip)
        return self._images is None or files.find(self._images, files.directory_here()) is not None

    def receive(self, chunks: Sequence[Any]) -> None:
        """Fetch the images from Ray's object store, part by part."""
        import ray

        assert self._images is not None  # `prepare` told that they are missing
        files.receive(self._images, files.directory_here(), map(ray.get, chunks))

    def run(self, job: bytes, gpus: Sequence[str] = ()) -> bytes:
        """Run a job, the arguments of `Sandbox.run`; return its answer, and what confined the candidate.

        `gpus` are those that Ray gave to the job: one, or none.

        Raises:
            SandboxError: as `Sandbox.run`; or the images were removed.
        """
        self._held.measures = ()
        entry, header, payload, limits, score = pickle.loads(job)
        if gpus:
            header = leased(header, gpus[0], per_gpu=self._order.per_gpu)
        answer = self._sandbox().run(entry, header, payload, limits, score)
        return pickle.dumps((answer, self._walls()))

    def _walls(self) -> dict[str, str] | None:
        """Describe what confined the candidate that this thread waited for, and on what; None where none was begun."""
        if not self._held.measures:
            return None
        here = machine()
        return {"node": f"{here['cpu']}, {here['system']}", **in_force(self._held.measures)}

    def _sandbox(self) -> Sandbox:
        """Return the sandbox, made with the first job; where Ray started this process again, nobody prepared it."""
        with self._lock:
            if self._opened is None:
                self._opened = Sandbox(
                    entries=self._order.entries,
                    environment=self._order.environment,
                    arrays=self._arrays(),
                    strongest=self._order.strongest,
                    notice=self._note,
                    zygote=self._zygote,
                    equip=self._order.equip,
                )
            return self._opened

    def _arrays(self) -> dict[str, Path]:
        if self._images is None:
            return {}
        directory = files.directory_here()
        path = files.find(self._images, directory)
        if path is None:
            expected = f"the images {self._images.digest[:12]}, which were brought here"
            raise SandboxError("a directory without them", place=str(directory), expected=expected)
        return {"images": path}

    def _note(self, measures: tuple[str, ...]) -> None:
        self._held.measures = measures
