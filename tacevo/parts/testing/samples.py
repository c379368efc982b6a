"""Questions that a part which decides is asked by the kit: from the smallest that can come to some of a long search."""

from collections.abc import Iterator, Mapping
from typing import Any

from tacevo.parts.kinds import ARCHIVES, DESCRIPTORS, FITNESS, PARENTS, PROMPTS, TEMPERATURES, Kind
from tacevo.parts.protocols import Generation, Population, PromptHistory, Trial
from tacevo.profile import Graph, Node, Profile, Step
from tacevo.randomness import stream
from tacevo.sandbox.part import SeenCandidate

_LAYERS = ("nn.Conv2d(3, {width}, 3)", "nn.BatchNorm2d({width})", "nn.GELU()", "nn.Dropout(0.{width})")


def ask(kind: Kind, part: Any) -> None:
    """Ask a part all questions of its kind; `part` is as `tacevo.runs.decisions.brought_part` returns it."""
    _ASKING[kind](part)


def _parents(part: Any) -> None:
    for population in _populations():
        pool = part.pool(population)
        for number in (1, 2) if part.crosses else (1,):
            if part.has_parents and len(pool) >= 2:
                for slot in range(3):
                    part.draw(pool, number, stream(0, "parents", population.generation, slot))


def _populations() -> Iterator[Population]:
    """Make populations: the baseline alone, a few, many; with equal fitnesses and equal sources among them."""
    for generation, size in ((1, 1), (1, 2), (2, 7), (30, 60)):
        candidates = [_candidate(number) for number in range(size)]
        yield Population(
            generation=generation,
            candidates={one.id: one for one in candidates},
            elites=[one for number, one in enumerate(candidates) if number % 3 == 0 or size <= 2],
        )


def _candidate(number: int) -> SeenCandidate:
    width = 8 * (1 + number % 5)
    layers = ", ".join(layer.format(width=width) for layer in _LAYERS[: 1 + number % 4])
    return SeenCandidate(
        id=f"g{number // 8:02d}s{number % 8:02d}",
        source=f"class Network(nn.Module):\n    def __init__(self):\n        self.layers = nn.Sequential({layers})\n",
        fitness=2.0 / (1 + number // 2),
        losses=(3.0, 2.0 / (1 + number // 2)),
        parameters=1_000 * width,
        flops=1_000_000 * width + number,
        parents=() if number == 0 else tuple(f"g{(number - back) // 8:02d}s{(number - back) % 8:02d}" for back in (1,)),
        curiosity=0.5 if number % 2 else 1.25,
    )


def _prompts(part: Any) -> None:
    trials = [
        Trial(prompt=number % 5, temperature=number / 10, inserted=number % 3 == 0, curiosity=0.5 + number % 3)
        for number in range(10)
    ]
    histories = (
        PromptHistory(trials=[], changes={}),
        PromptHistory(trials=trials, changes={0: (3, -0.4), 1: (1, 1.0), 4: (12, -2.5)}),
    )
    for history in histories:
        for pool in ((0,), (1, 4, 7), tuple(range(20))):
            for slot in range(3):
                part.draw(history, pool, stream(0, "prompt", len(pool), slot))


def _temperature(part: Any) -> None:
    for number, temperature, best, before in ((1, 0.5, 2.0, 2.0), (2, 0.0, 1.5, 2.0), (30, 1.0, 0.0, 0.01)):
        for trained, inserted in ((0, 0), (8, 0), (8, 8)):
            part.next(
                Generation(
                    number=number,
                    temperature=temperature,
                    best=best,
                    best_before=before,
                    candidates=8,
                    trained=trained,
                    inserted=inserted,
                )
            )


def _fitness(part: Any) -> None:
    for losses in ((0.7,), (0.0,), (3.0, 1.0, 2.0), (1e6, 1e-9), tuple(1 / (1 + epoch) for epoch in range(50))):
        part.of(losses)


def _descriptor(part: Any) -> None:
    for profile in _profiles():
        part.describe(profile)


def _profiles() -> Iterator[Profile]:
    """Make profiles: of a network without layers that have weights, and of a small convolutional one."""
    nothing = Graph(nodes=(), edges=(), channels=(), kernels=(), hidden=())
    yield Profile(parameters=1, flops=0, modules=1, graph=nothing)
    graph = Graph(
        nodes=(
            Node(op="conv2d", weighted=True, width=16),
            Node(op="relu", weighted=False, width=0),
            Node(op="add", weighted=False, width=0),
            Node(op="linear", weighted=True, width=7),
        ),
        edges=((0, 1), (0, 2), (1, 2), (2, 3)),
        channels=(16,),
        kernels=(3.0,),
        hidden=(),
    )
    image, features = (1, 3, 32, 32), (1, 16, 32, 32)
    steps = (
        Step(
            op="conv2d", weighted=True, sources=((),), operands=(image,), shape=features, kernel=(3, 3), stride=(1, 1)
        ),
        Step(op="relu", weighted=False, sources=((0,),), operands=(features,), shape=features),
        Step(op="add", weighted=False, sources=((0,), (1,)), operands=(features, features), shape=features),
        Step(op="linear", weighted=True, sources=((2,),), operands=((1, 16384),), shape=(1, 7)),
    )
    yield Profile(parameters=115_143, flops=1_114_112, modules=4, graph=graph, steps=steps, output=(3,))


def _archive(part: Any) -> None:
    for niches, axes in ((1, 1), (5, 2), (50, 2), (10, 3)):
        part.centroids(niches, axes)


_ASKING: Mapping[Kind, Any] = {
    PARENTS: _parents,
    PROMPTS: _prompts,
    TEMPERATURES: _temperature,
    FITNESS: _fitness,
    DESCRIPTORS: _descriptor,
    ARCHIVES: _archive,
}
