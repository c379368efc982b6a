"""Effects of a search without a model, a sandbox or a training: pure functions of the text that comes in."""

import hashlib
import random
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

from tacevo.choices import Scale
from tacevo.evolution import instructions, parents
from tacevo.evolution.algorithm import run_search
from tacevo.evolution.archive import NetworkArchive, Tessellation, find_centroids
from tacevo.evolution.descriptors import ArchDiv, EffRatio
from tacevo.evolution.development import Effects, Evaluate, Outcome
from tacevo.evolution.lines import SearchLine
from tacevo.evolution.proposals import Settings
from tacevo.evolution.run_files import line_kind
from tacevo.evolution.state import Plan, SearchState
from tacevo.evolution.temperatures import Paper
from tacevo.parts import Temperature
from tacevo.profile import Admitted, Graph, Node, Profile
from tacevo.records import (
    Completion,
    Contract,
    Instruction,
    Kind,
    Loss,
    Reason,
    Rejection,
    Request,
    Stage,
    Task,
    Training,
    to_json,
)
from tacevo.storage.canonical import content_hash
from tacevo.storage.ledger import Ledger

CONTRACT = Contract(
    class_name="Net",
    kind=Kind.regression,
    loss=Loss.mse,
    in_channels=3,
    image_size=32,
    outputs=3,
    output_argument="num_outputs",
)

TASK = Task(
    name="fake",
    contract=CONTRACT,
    baseline="class Net: pass\n",
    system="Write networks.",
    instructions=tuple(Instruction(id=f"i{number}", text=f"Do thing {number}.") for number in range(5)),
    crossover="Combine them.",
)

#: Small tessellations, found once.
NETWORKS = Tessellation(find_centroids(niches=12, dimensions=2, samples=500, seed=0))
PROMPTS = Tessellation(find_centroids(niches=8, dimensions=2, samples=500, seed=1))


def settings(**changes: object) -> Settings:
    """Return the settings of a small plan, with changes."""
    values = {
        "seed": 0,
        "candidates": 6,
        "mutation_probability": 0.7,
        "parents": parents.Uniform(),
        "prompts": instructions.Uniform(),
        "jitter": 0.1,
        "model": "fake-1",
        "max_tokens": 100,
    }
    return Settings(**{**values, **changes})  # type: ignore[arg-type]


def plan(*, generations: int = 4, rule: Temperature | None = None, **changes: object) -> Plan:
    """Return a small plan; `changes` go to its settings."""
    return Plan(
        task=TASK,
        settings=settings(**changes),
        generations=generations,
        initial=3,
        networks=NETWORKS,
        prompts=PROMPTS,
        archive=NetworkArchive(),
        axes={"arch_div": ArchDiv(), "eff_ratio": EffRatio(eff_ratio_scale=Scale.linear)},
        temperature=rule or Paper(step=0.05),
        temperature_start=0.6,
    )


def number(text: str, below: int) -> int:
    """Draw a number in [0, below) that follows from a text."""
    return int(hashlib.sha256(text.encode()).hexdigest(), 16) % below


class FakeLLM:
    """Answers with a source that follows from the request; one in eight answers is hopeless."""

    def __init__(self) -> None:
        self.asked = 0

    def complete(self, requests: Sequence[Request]) -> Iterator[tuple[int, Completion]]:
        """Answer backwards: the order of arrival is not that of the slots."""
        for position in reversed(range(len(requests))):
            self.asked += 1
            mark = content_hash(to_json(requests[position]))
            text = "no idea" if number(mark, 8) == 0 else f"class Net: mark = {number(mark, 40)}\n"
            yield (
                position,
                Completion(text=text, model="fake-1", stop_reason="end_turn", input_tokens=1, output_tokens=1),
            )


def inspect(source: str) -> Admitted | Rejection:
    """Admit every source with a class, with a profile that follows from the text."""
    if not source.startswith("class Net"):
        return Rejection(stage=Stage.extract, reason=Reason.no_class, detail="no class Net")
    width = 2 + number(source, 60)
    nodes = tuple(Node(op=f"op{index % 3}", weighted=True, width=width) for index in range(2 + number(source, 5)))
    edges = tuple((index, index + 1) for index in range(len(nodes) - 1))
    graph = Graph(nodes=nodes, edges=edges, channels=(width, 8), kernels=(3.0,), hidden=())
    return Admitted(
        source=source, profile=Profile(parameters=100 * width, flops=number(source, 9_000), modules=3, graph=graph)
    )


def admit(completion: Completion, asked: str) -> Admitted | Rejection:
    """Put an answer through the fake gate."""
    return inspect(completion.text)


def evaluate(source: str) -> Training | Rejection:
    """Train by hashing; one in ten fails."""
    if number(source, 10) == 0:
        return Rejection(stage=Stage.train, reason=Reason.not_finite, detail="loss is nan")
    loss = (1 + number(source, 1_000)) / 1_000
    return Training(
        train_losses=(1.0, loss), validation_losses=(1.0, loss), predictions_sha256="0" * 64, weights_sha256="1" * 64
    )


def effects(llm: FakeLLM | None = None, executor: Executor | None = None) -> Effects:
    """Return fake effects; without an executor, with one thread."""
    return Effects(
        llm=llm or FakeLLM(),
        admit=admit,
        inspect=inspect,
        measure=inspect,
        evaluate=evaluate,
        evaluation_key=content_hash,
        executor=executor or ThreadPoolExecutor(1),
        cpu_seconds=lambda: 0.0,
    )


@dataclass
class Recorder:
    """An observer that remembers."""

    outcomes: list[Outcome] = field(default_factory=list)
    lines: list[SearchLine] = field(default_factory=list)
    states: list[SearchState] = field(default_factory=list)

    def developed(self, outcome: Outcome) -> None:
        """Remember an outcome."""
        self.outcomes.append(outcome)

    def committed(self, line: SearchLine, state: SearchState) -> None:
        """Remember a line and the state behind it."""
        self.lines.append(line)
        self.states.append(state)


def until_killed(trainings: int) -> Evaluate:
    """Train as `evaluate` does, with delays that differ, and end the search like Ctrl-C after so many trainings."""
    delays, left = random.Random(0), iter(range(trainings))  # the order of threads is not reproducible anyway

    def train(source: str) -> Training | Rejection:
        time.sleep(delays.random() / 500)
        if next(left, None) is None:
            raise KeyboardInterrupt
        return evaluate(source)

    return train


def search(plan: Plan, path: Path | None = None, **changes: object) -> tuple[str, Recorder]:
    """Search; return the digest, and what an observer saw."""
    recorder = Recorder()
    changed = replace(effects(), **changes)  # type: ignore[arg-type]
    with Ledger() if path is None else Ledger.open(path, line_kind) as ledger:
        run_search(plan, changed, ledger, recorder)
        return ledger.digest, recorder
