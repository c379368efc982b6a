"""Two rules that choose parents: epsilon-lexicase selection and ageing evolution."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import TypeVar

import numpy as np

from tacevo.parts import Candidate, Parents, Population

C = TypeVar("C", bound=Candidate)

#: What a case may be: a number of a candidate among others, of which lower is better.
CASES: Mapping[str, Callable[[Candidate, Sequence[Candidate]], float]] = {
    "fitness": lambda one, among: one.fitness,
    "flops": lambda one, among: one.flops,
    "parameters": lambda one, among: one.parameters,
    "novelty": lambda one, among: -novelty(one, among),
}


@dataclass(frozen=True)
class Lexicase(Parents):
    """Elites that are good at something, by epsilon-lexicase selection (La Cava, Spector and Danai 2016).

    For each parent the cases come in a random order. Of the candidates that are left, each case keeps those that are
    at most epsilon worse than the best of them. Epsilon is the median absolute deviation of the case in the pool.
    """

    #: Names of `CASES`, with commas between them.
    cases: str = "fitness,flops,parameters,novelty"

    def __post_init__(self) -> None:
        """Refuse a case that is not known."""
        unknown = [name for name in self.cases.split(",") if name not in CASES]
        if unknown:
            raise ValueError(f"cases: expected names of {', '.join(CASES)}; got {', '.join(unknown)}")

    def draw(self, pool: Sequence[C], number: int, rng: np.random.Generator) -> Sequence[C]:
        """Select so many different candidates, one after the other."""
        values = {name: {one.id: CASES[name](one, pool) for one in pool} for name in self.cases.split(",")}
        drawn: list[C] = []
        for _ in range(number):
            left = [one for one in pool if one not in drawn]
            for index in rng.permutation(len(values)):
                case = list(values.values())[index]
                best = min(case[one.id] for one in left)
                left = [one for one in left if case[one.id] <= best + deviation(case.values())]
            drawn.append(left[rng.integers(len(left))])
        return drawn


@dataclass(frozen=True)
class Ageing(Parents):
    """The fittest of a random sample of the youngest: ageing evolution (Real, Aggarwal, Huang and Le 2019)."""

    #: How many of the youngest candidates live.
    population: int = 20
    #: How many of them compete to be a parent.
    sample: int = 5

    def __post_init__(self) -> None:
        """Refuse numbers of which no two parents can be drawn."""
        if self.population < 2 or self.sample < 1:
            raise ValueError("expected a population of at least 2 and a sample of at least 1")

    def pool(self, population: Population) -> Sequence[Candidate]:
        """Return those that live."""
        return list(population.candidates.values())[-self.population :]

    def draw(self, pool: Sequence[C], number: int, rng: np.random.Generator) -> Sequence[C]:
        """Draw so many different winners."""
        drawn: list[C] = []
        for _ in range(number):
            left = [one for one in pool if one not in drawn]
            sample = rng.choice(len(left), min(self.sample, len(left)), replace=False)
            drawn.append(min((left[index] for index in sample), key=lambda one: (one.fitness, one.id)))
        return drawn


def deviation(values: Iterable[float]) -> float:
    """Return the median absolute deviation of some values, at least one."""
    values = list(values)
    middle = median(values)
    return median(abs(value - middle) for value in values)


def novelty(one: Candidate, among: Sequence[Candidate], nearest: int = 3) -> float:
    """Return how far a source is from the nearest others, in [0, 1]; 0 where there is no other.

    The distance of two sources is that of Jaccard between the sets of their words and numbers.
    """
    own = words(one.source)
    distances = sorted(distance(own, words(other.source)) for other in among if other.id != one.id)[:nearest]
    return sum(distances) / len(distances) if distances else 0.0


def words(source: str) -> frozenset[str]:
    """Return the words and numbers of a source, each once."""
    return frozenset(re.findall(r"\w+", source))


def distance(first: frozenset[str], second: frozenset[str]) -> float:
    """Return the part of the words of two sources that only one of them has."""
    return len(first ^ second) / max(len(first | second), 1)
