"""What a cluster of many slots costs: `python -m benchmarks.cluster --slots 64`.

A real search, by the grammar, into real stores and a real ledger, over a real Ray with so many slots on this machine.
Only the sandbox is made up: a training sleeps for a time in proportion to its FLOPs, and a probe for a fixed time.
"""

import argparse
import pickle
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks.synthetic import made_up, profile_of_baseline, synthetic_dataset, synthetic_setting
from tacevo.cluster.cluster import Cluster
from tacevo.cluster.node import ClusterNode
from tacevo.cluster.node_images import Images
from tacevo.config.schema import RunConfig
from tacevo.parts.executor import Order
from tacevo.profile import Profile
from tacevo.records import Json, Limits
from tacevo.runs.progress import Progress
from tacevo.runs.session import record
from tacevo.sandbox.client import Died, Finished, Score
from tacevo.training.numerics import environment

#: Seconds of a probe, which takes tens of milliseconds in a sandbox.
_PROBE = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class SleepingOrder(Order):
    """An order whose jobs are slept through."""

    baseline: Profile
    epochs: int
    outputs: int
    #: Of a training of the baseline.
    seconds: float


class SleepingNode(ClusterNode):
    """The process of a node that sleeps in place of its sandbox, and says from when to when, by the machine's clock."""

    def __init__(self, order: SleepingOrder, images: Images | None) -> None:
        super().__init__(order, images)
        self._sleeping = order
        self._answers = made_up(order.baseline, order.epochs, order.outputs)

    def prepare(self) -> bool:
        """Start nothing."""
        return True

    def run(self, job: bytes, gpus: Sequence[str] = ()) -> bytes:
        """Sleep as long as the job would take; return a made-up answer, and the times."""
        began = time.monotonic()
        entry, header, payload, limits = pickle.loads(job)
        order = self._sleeping
        time.sleep(_PROBE if entry == "probe" else order.seconds * self._share(header))
        answer = self._answers(entry, header, payload, limits)
        return pickle.dumps((answer, {"began": repr(began), "ended": repr(time.monotonic())}))

    def _share(self, header: Any) -> float:
        """Return the FLOPs of a candidate in parts of the baseline's, as its made-up probe has them."""
        probe = self._answers("probe", header, b"", Limits(seconds=1, memory_mib=64))
        assert isinstance(probe, Finished)
        flops = probe.frames[0].header["profile"]["flops"]  # type: ignore[index, call-overload]
        return float(flops / self._sleeping.baseline.flops)  # type: ignore[operator]


@dataclass(frozen=True, slots=True)
class Span:
    """The times of a job, by the machine's monotonic clock, in seconds: asked for, begun, ended, answered."""

    entry: str
    asked: float
    began: float
    ended: float
    answered: float


class Crowded(Cluster):
    """A cluster whose slots have no process of their own, of which a machine could not hold hundreds (78 MiB each)."""

    def _submit(self, flight: Any) -> Any:
        (node,) = self._members.values()
        return node.process.run.remote(flight.job)


class Watched:
    """Runs jobs on a cluster and keeps their times."""

    def __init__(self) -> None:
        self.spans: list[Span] = []
        self.cluster: Cluster | None = None
        self._times = threading.local()

    def note(self, times: Mapping[str, str]) -> None:
        """Take the times of a node, in the thread that waits for its answer."""
        self._times.of_node = float(times["began"]), float(times["ended"])

    def run(
        self, entry: str, header: Json, payload: bytes, limits: Limits, score: Score | None = None
    ) -> Finished | Died:
        """Run a job, as `Cluster.run`."""
        assert self.cluster is not None
        asked = time.monotonic()
        answer = self.cluster.run(entry, header, payload, limits, score)
        began, ended = self._times.of_node
        self.spans.append(Span(entry, asked, began, ended, time.monotonic()))
        return answer


def measure(slots: int, candidates: int, generations: int, seconds: float, kind: type[Cluster]) -> str:
    """Search with so many slots, and so many candidates a generation; return what it took, in words."""
    watched = Watched()
    with tempfile.TemporaryDirectory() as folder:
        config, task, facts = synthetic_setting(Path(folder), generations)
        baseline = profile_of_baseline(config, task, facts)
        config = _sized(config, slots, candidates)
        order = SleepingOrder(
            entries={},
            equip=None,
            environment=environment(config.numerics.kind),
            gpu=None,
            per_gpu=1,
            numerics=config.numerics.kind,
            device=config.training.device,
            require=config.sandbox.require,
            baseline=baseline,
            epochs=config.training.epochs,
            outputs=facts.outputs,
            seconds=seconds,
        )
        with kind(order, None, address=None, workers=slots, notice=watched.note, process=SleepingNode) as cluster:
            watched.cluster = cluster
            _warm_up(watched, slots)
            began, cpu = time.monotonic(), time.process_time()
            record(config, task, synthetic_dataset(facts), Progress(), run=watched.run)
            wall, cpu = time.monotonic() - began, time.process_time() - cpu
    return _report(watched.spans, slots, wall, cpu)


def _sized(config: RunConfig, slots: int, candidates: int) -> RunConfig:
    return replace(
        config,
        search=replace(config.search, candidates=candidates),
        executor=replace(config.executor, workers=slots),
        gate=replace(config.gate, memory_mib=64),
        training=replace(config.training, memory_mib=64),
    )


def _warm_up(watched: Watched, slots: int) -> None:
    """Have Ray start the process of each slot, which a search of hours does once."""
    header: Json = {"source": ""}
    limits = Limits(seconds=60, memory_mib=64)
    threads = [threading.Thread(target=watched.run, args=("train", header, b"", limits)) for _ in range(slots)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    watched.spans.clear()


def _report(spans: list[Span], slots: int, wall: float, cpu: float) -> str:
    """Say what of the time was work."""
    trainings = [span for span in spans if span.entry == "train"]
    busy = sum(span.ended - span.began for span in spans)
    starting = sorted(span.began - span.asked for span in trainings)
    ending = sorted(span.answered - span.ended for span in trainings)
    each = cpu / len(trainings)
    return (
        f"{slots} slots, {len(trainings)} trainings of {_mean(trainings):.2f} s: {wall:.1f} s; "
        f"slots busy {busy / (slots * wall):.1%}; from the call to the start {_middle(starting)} ms, "
        f"from the end to the answer {_middle(ending)} ms (median, 95 %); "
        f"processor time of the search {1e3 * each:.1f} ms a candidate, so {slots} slots keep it busy only where a "
        f"training takes less than {each * slots:.1f} s"
    )


def _mean(spans: list[Span]) -> float:
    return sum(span.ended - span.began for span in spans) / len(spans)


def _middle(values: list[float]) -> str:
    return f"{1e3 * values[len(values) // 2]:.1f}, {1e3 * values[int(0.95 * len(values))]:.1f}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--slots", type=int, default=8)
    parser.add_argument("--candidates", type=int, default=50, help="of a generation")
    parser.add_argument("--generations", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=2.0, help="of a training of the baseline")
    parser.add_argument(
        "--crowded", action="store_true", help="without the process of each slot: for hundreds of slots"
    )
    options = parser.parse_args()
    kind = Crowded if options.crowded else Cluster
    print(measure(options.slots, options.candidates, options.generations, options.seconds, kind))
