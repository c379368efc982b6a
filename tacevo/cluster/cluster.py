"""The driver's side: what runs jobs on the nodes of a Ray cluster, as a sandbox runs them here.

Promises: a node that computes something else gets no job; a job that is lost with its node or a process of Ray runs
again, elsewhere or there, and a candidate's own end is never such a loss; when the cluster is closed, nothing of the
run is left on any node. docs/cluster.md says what each rests on.
"""

import contextlib
import os
import pickle
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, InvalidStateError
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Self

from tacevo.choices import Confinement
from tacevo.cluster.connection import connect, is_guarded, leave
from tacevo.cluster.node import ClusterNode
from tacevo.cluster.node_images import Images
from tacevo.cluster.node_members import ClusterMember, Described, join, works
from tacevo.cluster.slot import run_job
from tacevo.errors import SandboxError
from tacevo.parts.executor import Notice, Order
from tacevo.records import Json, Limits
from tacevo.sandbox.client import Died, Finished, Score
from tacevo.sandbox.protocol import describe
from tacevo.text import counted
from tacevo.training.leases import gpu_share

#: The number of times that Ray runs a lost job again.
_RETRIES = 5

#: Seconds between two looks at the nodes.
_TICK = 2.0

#: Ray's own setting: seconds after which it ends a process that does not reach the head; 60 unless set.
_PATIENCE_OF_RAY = "RAY_gcs_rpc_server_reconnect_timeout_s"

#: The number of looks at a node that Ray lost while it joined.
_TRIES = 3

#: Seconds that a node which joins may still take when the cluster is closed.
_GOODBYE = 5.0

_AGAIN = "run the same command again"


@dataclass(eq=False, kw_only=True)
class _Flight:
    """A job on its way."""

    job: bytes
    #: The resources that the job needs, by Ray's names.
    needs: Mapping[str, float]
    #: The answer's bytes, for which the thread that asked waits.
    landed: "Future[bytes]" = field(default_factory=Future)
    #: Ray's name for its answer, and the nodes that it may run on.
    ref: Any = None
    nodes: frozenset[str] = frozenset()


class Cluster:
    """Runs jobs on the nodes of a Ray cluster; several threads may call `run` at once.

    The main thread makes it. Every node is checked before it gets work, and gets the images where it lacks them; so is
    one that joins later.

    Args:
        order: what each node must do.
        images: of the data set, and the file that they lie in; None where nothing is trained.
        address: of the cluster's head, as HOST:PORT, or `auto`; None to start a Ray here, which ends with this process.
        workers: jobs at once, which is the number of slots of a Ray that is started.
        notice: called for every candidate before its answer is returned, by the thread that waits for it.
        process: what runs on each node.
        say: called with a line for the user.

    Raises:
        ConfigError: Ray is not installed, or no cluster answers.
        SandboxError: no node can be used; the error is that of the first.
    """

    def __init__(
        self,
        order: Order,
        images: tuple[Images, Path] | None,
        *,
        address: str | None,
        workers: int,
        notice: Notice | None = None,
        process: type[ClusterNode] = ClusterNode,
        say: Callable[[str], None] | None = None,
    ) -> None:
        self._order, self._images = order, images
        self._notice, self._process, self._say = notice, process, say
        self._lock = threading.Lock()
        self._flights: set[_Flight] = set()
        self._members: dict[str, ClusterMember] = {}
        #: The number of looks at each node.
        self._tries: Counter[str] = Counter()
        #: The error that keeps further jobs from running; None while they can run.
        self._end: SandboxError | None = None
        self._stop = threading.Event()
        self._is_lost = False
        self._duties = [
            threading.Thread(target=duty, name="cluster", daemon=True)
            for duty in (self._watch, self._receive, self._listen)
        ]
        self._ray = ray = connect(address, workers)
        if not is_guarded():
            self._tell(
                "warning: this Ray cluster has no token: anyone who can connect to it can run code on it "
                "(docs/cluster.md)"
            )
        again = [ray.exceptions.RayActorError, SandboxError]
        self._task = ray.remote(max_retries=_RETRIES, retry_exceptions=again)(run_job)
        self._head: str = ray.get_runtime_context().gcs_address
        try:
            refused = self._welcome(ray.nodes())
            if not self._members:
                raise refused[0] if refused else SandboxError("no node", place="Ray", expected="a node with a CPU")
            self._introduce(refused, workers)
        except BaseException:
            self.close()
            raise
        for duty in self._duties:
            duty.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def run(
        self, entry: str, header: Json, payload: bytes, limits: Limits, score: Score | None = None
    ) -> Finished | Died:
        """Run one job where a slot is free, and wait for it, as `Sandbox.run`.

        Raises:
            SandboxError: a node's sandbox failed, or the job was lost, time and again; no node has room for it; or the
                cluster is gone. This says nothing about the candidate.
        """
        needs = {"CPU": 1.0, "memory": limits.memory_mib * 2.0**20}
        if isinstance(header, Mapping) and "device" in header:
            needs["GPU"] = gpu_share(self._order.device, self._order.per_gpu)
        flight = _Flight(job=pickle.dumps((entry, header, payload, limits, score)), needs=needs)
        try:
            with self._lock:
                if self._end is not None:
                    raise self._end
                self._flights.add(flight)
                self._launch(flight)
            answer, walls = pickle.loads(flight.landed.result())
        finally:
            with self._lock:
                self._flights.discard(flight)
        if walls is not None and self._notice is not None:
            self._notice(walls)
        result: Finished | Died = answer
        return result

    def close(self) -> None:
        """End every job and every process of this run; calls to `run` that wait raise `SandboxError`."""
        self._finish(SandboxError("the cluster was left while a candidate ran", remedy=_AGAIN))
        self._stop.set()
        for duty in self._duties:
            if duty.is_alive() and not self._is_lost:  # without its head Ray answers no thread, and ends this process
                duty.join(_GOODBYE)
        with self._lock:
            processes = [node.process for node in self._members.values()]
        leave(self._ray, processes, is_lost=self._is_lost)

    def _finish(self, error: SandboxError) -> None:
        """Let this error end all jobs, those to come too; an earlier one stays."""
        with self._lock:
            self._end = self._end or error
            for flight in self._flights:
                _land(flight, error=self._end)

    def _launch(self, flight: _Flight) -> None:
        """Hand a job to Ray, for any node that has room for it; without a node it waits for one. The lock is held."""
        if not self._members:
            return
        nodes = frozenset(name for name, node in self._members.items() if node.has(flight.needs))
        if not nodes:
            _land(flight, error=self._no_room(flight))
            return
        flight.nodes = nodes
        try:
            flight.ref = self._submit(flight)
            flight.ref.future().add_done_callback(partial(self._take, flight, flight.ref))
        except Exception as error:  # Ray's or gRPC's
            _land(flight, error=self._translated(error))

    def _submit(self, flight: _Flight) -> Any:
        """Make a job a task of Ray; return Ray's name for its answer."""
        return self._task.options(
            num_cpus=flight.needs["CPU"],
            memory=flight.needs["memory"],
            num_gpus=flight.needs.get("GPU", 0),
            scheduling_strategy="SPREAD",
            label_selector={"ray.io/node-id": f"in({','.join(sorted(flight.nodes))})"},
        ).remote(flight.job)

    def _take(self, flight: _Flight, ref: Any, answer: "Future[bytes]") -> None:
        """Pass on what came of a job, unless it was handed to Ray again since; a thread of Ray's calls this."""
        if flight.ref is not ref:
            return
        error = answer.exception()
        if error is None:
            _land(flight, answer=answer.result())
        elif isinstance(error, self._ray.exceptions.TaskUnschedulableError):
            flight.nodes = frozenset()  # all that it might run on are gone: the watcher hands it to others
        else:
            _land(flight, error=self._translated(error))

    def _translated(self, error: BaseException) -> SandboxError:
        """Turn an error of Ray's into one of ours; a node's own error stays as it is."""
        cause = error
        while isinstance(cause, self._ray.exceptions.RayTaskError):
            cause = cause.cause
        if isinstance(cause, SandboxError):
            return cause
        return SandboxError(
            describe(cause),
            place="Ray",
            expected=f"one of {1 + _RETRIES} attempts at a job to end",
            remedy=_AGAIN,
        )

    def _no_room(self, flight: _Flight) -> SandboxError:
        largest = max((node.resources for node in self._members.values()), key=lambda has: has.get("memory", 0.0))
        return SandboxError(
            f"{_words(largest)} on the largest",
            place="the nodes of the cluster",
            expected=f"one with {_words(flight.needs)} for a candidate",
            remedy="lower gate.memory_mib and training.memory_mib, or start Ray with more: `ray start --memory=BYTES`",
        )

    def _welcome(self, nodes: Sequence[Described]) -> list[SandboxError]:
        """Let nodes join that are new, or that were lost while they joined; return why others are refused."""
        new = [
            node
            for node in nodes
            if works(node) and self._tries[node["NodeID"]] < _TRIES and node["NodeID"] not in self._members
        ]
        if not new:
            return []
        self._tries.update(node["NodeID"] for node in new)
        joined, refused = join(self._ray, new, self._process, self._order, self._images)
        with self._lock:
            self._members.update(joined)
        self._tries.update({refusal.node: _TRIES for refusal in refused if refusal.is_final})
        return [refusal.error for refusal in refused]

    def _introduce(self, refused: Sequence[SandboxError], workers: int) -> None:
        """Say what the cluster is, how well it confines, and what of it is not used."""
        for error in refused:
            self._tell(f"a node is refused: {error}")
        members = self._members.values()
        slots = int(sum(node.resources["CPU"] for node in members))
        weakest = min(members, key=lambda node: list(Confinement).index(node.level))
        self._tell(f"cluster: {counted(len(members), 'node')}, {counted(slots, 'slot')}, executor.workers={workers}")
        self._tell(f"confinement: {weakest.level}, the weakest, on {weakest.name}")

    def _tell(self, line: str) -> None:
        if self._say is not None:
            self._say(line)

    def _watch(self) -> None:
        """Look after the nodes until the cluster is closed."""
        while not self._stop.wait(_TICK):
            with contextlib.suppress(Exception):  # the head is gone, or the cluster is being closed
                self._look_after(self._ray.nodes())

    def _receive(self) -> None:
        """Let nodes join; a thread of its own, for one may take long."""
        while not self._stop.wait(_TICK):
            with contextlib.suppress(Exception):  # as in `_watch`
                for error in self._welcome(self._ray.nodes()):
                    self._tell(f"a node is refused: {error}")

    def _listen(self) -> None:
        """End all jobs when the head has been silent for too long; a thread of its own, for Ray waits for the head."""
        heard = time.monotonic()
        while not self._stop.wait(_TICK):
            if self._head_answers():
                heard = time.monotonic()
            silent = time.monotonic() - heard
            if silent > _head_seconds():
                self._is_lost = True
                expected, remedy = "the head of the Ray cluster", f"start it again, and {_AGAIN}"
                got = f"no answer for {silent:.0f} s"
                self._finish(SandboxError(got, place=self._head, expected=expected, remedy=remedy))
                return

    def _head_answers(self) -> bool:
        host, _, port = self._head.rpartition(":")
        try:
            socket.create_connection((host, int(port)), timeout=_TICK).close()
        except OSError:
            return False
        return True

    def _look_after(self, nodes: Sequence[Described]) -> None:
        """Take out nodes that are gone, and hand jobs that were meant for them to others."""
        alive = {node["NodeID"] for node in nodes if node["Alive"]}
        with self._lock:
            gone = [self._members.pop(name) for name in self._members.keys() - alive]
        for node in gone:
            self._tell(f"{node.name} is gone; its jobs run again on others")
        with self._lock:
            stranded = [flight for flight in self._flights if flight.nodes.isdisjoint(self._members)]
            for flight in stranded:
                self._launch(flight)


def _land(flight: _Flight, *, answer: bytes = b"", error: SandboxError | None = None) -> None:
    """Give the answer of a job, or the error that ended it, to the thread that waits; the first one counts."""
    with contextlib.suppress(InvalidStateError):
        if error is None:
            flight.landed.set_result(answer)
        else:
            flight.landed.set_exception(error)


def _words(amounts: Mapping[str, float]) -> str:
    memory = f"{amounts.get('memory', 0.0) / 2**20:,.0f} MiB"
    return f"{amounts.get('CPU', 0.0):g} CPU, {memory} and {amounts.get('GPU', 0.0):g} GPU"


def _head_seconds() -> float:
    """Return after how many seconds a silent head counts as lost: before Ray ends this process for it."""
    return 0.5 * float(os.environ.get(_PATIENCE_OF_RAY, "60"))
