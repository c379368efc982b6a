"""What an optimiser is, how it searches a table by ask and tell, and what it hands over."""

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from typing import NamedTuple

from tacevo.api.space_problems import SpaceProblem, Value
from tacevo.randomness import stream

#: The choices of each gene, and a network by its genes.
Choices = Mapping[str, Sequence[Value]]
Genes = Mapping[str, Value]

#: Searches by the choices of each gene, a seed, and the number of trainings that it will get: yields the genes of a
#: network, and is sent its fitness, which is lower where the network is better.
Optimiser = Callable[[Choices, int, int], Generator[Genes, float, None]]

#: An optimiser that asks so many times for each training, and mostly for networks that it has seen, is stopped.
MOST_ASKED = 10


class Visit(NamedTuple):
    """A network when a search trains it for the first time."""

    genes: Genes
    #: The number of the recorded seed that evaluates it.
    seed: int
    fitness: float


def visits(
    optimiser: Optimiser, problem: SpaceProblem, *, seed: int, trainings: int, epochs: int, failed: float
) -> list[Visit]:
    """Let an optimiser search; return its trainings, in order.

    A network that it asks for again is remembered, and is no training. Each network has one recorded seed in a search,
    which is drawn from the search's seed alone: optimisers of equal seeds meet equal noise.

    Args:
        optimiser: which searches.
        problem: that is searched.
        seed: of the search.
        trainings: that it may spend; it may end with fewer, if it asks again and again for what it knows.
        epochs: of each.
        failed: the fitness that it is told of a network that failed, in place of infinity.
    """
    seen: dict[tuple[Value, ...], Visit] = {}
    with closing(optimiser(problem.genes, seed, trainings)) as asking:
        genes = next(asking)
        for _ in range(MOST_ASKED * trainings):
            key = tuple(genes[name] for name in problem.genes)
            if key not in seen:
                drawn = drawn_seed(problem, seed, genes)
                fitness = problem.evaluate(genes, seed=drawn, epochs=epochs).fitness
                seen[key] = Visit(dict(genes), drawn, fitness)
            if len(seen) == trainings:
                break
            fitness = seen[key].fitness
            genes = asking.send(fitness if math.isfinite(fitness) else failed)
    return list(seen.values())


def drawn_seed(problem: SpaceProblem, seed: int, genes: Genes) -> int:
    """Draw the recorded seed of a network in a search: noise is independent between networks."""
    number = 0
    for name, choices in problem.genes.items():
        number = number * len(choices) + choices.index(genes[name])
    return int(stream(seed, "peers_table", "noise", number).integers(problem.seeds))


def handed_over(found: Sequence[Visit], trainings: int) -> Visit:
    """Return the network that a search hands over after so many trainings: its fittest, the first of equal ones."""
    return min(found[:trainings], key=lambda visit: visit.fitness)
