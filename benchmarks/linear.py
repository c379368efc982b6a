"""Whether a candidate costs the same late in a search as early: one fold, recorded and then replayed.

    python -m benchmarks.linear    # 100,000 candidates, with 1,000 and 10,000 niches: ten minutes

Models, gate and trainings are made up and cost nothing; what is timed is the search's own work: propose, offer, commit,
the ledger. It is processor time, and the ledger lies in memory, because it waits for a disk at every line.
"""

import hashlib
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.timing import Figure
from tacevo.config.compose import compose
from tacevo.config.tasks import facts_without_data, load_task
from tacevo.evolution.algorithm import run_search
from tacevo.evolution.archive import Tessellation
from tacevo.evolution.development import Effects, Outcome
from tacevo.evolution.files import line_kind
from tacevo.evolution.lines import SearchLine
from tacevo.evolution.state import Plan, SearchState
from tacevo.profile import Admitted, Graph, Node, Profile
from tacevo.records import Completion, Mode, Request, Training, to_json
from tacevo.runs.wiring import build_plan
from tacevo.storage.canonical import content_hash
from tacevo.storage.ledger import Ledger


def linear(*, marks: Sequence[int] = (1_000, 20_000), niches: Sequence[int] = (1_000,)) -> Iterator[Figure]:
    """Fold made-up candidates, in the paper's settings; the time of one should not depend on how many there were.

    Args:
        marks: numbers of candidates, multiples of 100, each at least twice the one before; the time of one is taken
            over the half before each mark. Over fewer candidates a collection of Python's garbage falls into it or not,
            by chance.
        niches: of the archives to try.
    """
    for count in niches:
        with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
            plan, path = _plan(Path(folder), count, marks[-1]), Path(folder) / "ledger.jsonl"
            for what in ("recorded", "replayed"):
                watch = _Watch(marks)
                with Ledger.open(path, line_kind) as ledger:
                    run_search(plan, _effects(), ledger, watch)
                for mark in marks[1:]:
                    yield Figure(
                        title=f"a candidate {what}, {count:,} niches",
                        name=f"after {mark:,}",
                        value=1e6 * watch.seconds[mark],
                        unit="us",
                        peer=f"after {marks[0]:,}",
                        peer_value=1e6 * watch.seconds[marks[0]],
                    )


class _Watch:
    """Takes the processor time of a candidate at each mark."""

    def __init__(self, marks: Sequence[int]) -> None:
        #: Of one candidate, by mark.
        self.seconds: dict[int, float] = {}
        self._marks, self._starts = set(marks), {mark // 2 for mark in marks}
        self._count = 0
        self._began = 0.0

    def developed(self, outcome: Outcome) -> None:
        """Nothing is timed before it is committed."""

    def committed(self, line: SearchLine, state: SearchState) -> None:
        """Begin or end a time at the end of a generation."""
        if line.kind == "candidate":
            self._count += 1
            return
        if self._count in self._marks:
            self.seconds[self._count] = (time.process_time() - self._began) / (self._count // 2)
        if self._count in self._starts:
            self._began = time.process_time()


def _plan(folder: Path, niches: int, candidates: int) -> Plan:
    """Return the plan of a search of the paper's, with 50 candidates a generation, generation 0 included."""
    size = ["search.candidates=50", "search.initial=49"]
    config = compose(["experiment=paper_force", "llm=grammar", f"store.root={folder}", *size])
    facts = facts_without_data(config)
    plan = build_plan(config, load_task(config, facts), facts, Mode.record)
    centroids = np.random.default_rng(0).random((niches, 2))
    return replace(plan, networks=Tessellation(centroids), generations=candidates // 50 - 1)


def _effects() -> Effects:
    """Return effects that are pure functions of what comes in."""
    return Effects(
        llm=_Mark(),
        admit=lambda completion, quoted: _admitted(completion.text),
        inspect=_admitted,
        measure=_admitted,
        evaluate=_trained,
        evaluation_key=lambda source, seed: source,
        executor=_Here(),
        cpu_seconds=lambda: 0.0,
    )


class _Mark:
    """Answers each request with the hash of it."""

    def complete(self, requests: Sequence[Request]) -> Iterator[tuple[int, Completion]]:
        """Answer in order."""
        for position, request in enumerate(requests):
            text = content_hash(to_json(request))
            yield position, Completion(text=text, model="none", stop_reason="end_turn", input_tokens=0, output_tokens=0)


class _Here(Executor):
    """Works at once, in the thread that asks."""

    def submit(self, work, /, *arguments, **named):  # type: ignore[no-untyped-def]
        """Return a future that is done."""
        done = Future()  # type: ignore[var-annotated]
        done.set_result(work(*arguments, **named))
        return done


def _admitted(source: str) -> Admitted:
    return Admitted(source=source, profile=_profile(8 + _bytes_of(source)[:3].astype(int)))


def _profile(sizes: np.ndarray) -> Profile:
    """Return the profile of a chain of layers with these widths."""
    widths = tuple(int(size) for size in sizes)
    graph = Graph(
        nodes=tuple(Node(op="conv", weighted=True, width=width) for width in widths),
        edges=tuple((index, index + 1) for index in range(len(widths) - 1)),
        channels=widths,
        kernels=(3.0,) * len(widths),
        hidden=(),
    )
    return Profile(parameters=100 * sum(widths), flops=10_000 * sum(widths), modules=len(widths), graph=graph)


def _trained(source: str, seed: int) -> Training:
    loss = float(_bytes_of(source)[8:16].view(np.uint64)[0]) / 2**64
    return Training(
        train_losses=(loss,), validation_losses=(loss,), predictions_sha256="0" * 64, weights_sha256="0" * 64
    )


def _bytes_of(source: str) -> np.ndarray:
    return np.frombuffer(hashlib.sha256(source.encode()).digest(), np.uint8)


if __name__ == "__main__":
    for figure in linear(marks=(1_000, 10_000, 100_000), niches=(1_000, 10_000)):
        print(figure, flush=True)
