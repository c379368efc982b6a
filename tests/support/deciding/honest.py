"""Parts of every kind that decides, as a user writes them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import neighbour
import numpy as np

from tacevo.parts import (
    Archive,
    Candidate,
    Descriptor,
    Fitness,
    Generation,
    Parents,
    Population,
    PromptHistory,
    Prompts,
    Temperature,
)
from tacevo.profile import Profile

C = TypeVar("C", bound=Candidate)


@dataclass(frozen=True)
class Greedy(Parents):
    """The fittest of all that trained."""

    k: int = 2
    margin: float = 0.0

    def pool(self, population: Population) -> Sequence[Candidate]:
        return neighbour.ranked(population.candidates.values())[: self.k]

    def draw(self, pool: Sequence[C], number: int, rng: np.random.Generator) -> Sequence[C]:
        return [pool[index] for index in rng.choice(len(pool), number, replace=False)]


@dataclass(frozen=True)
class Last(Prompts):
    """The last instruction of the pool, and no prompt archive."""

    records = False

    def draw(self, history: PromptHistory, pool: Sequence[int], rng: np.random.Generator) -> int:
        return pool[-1]


@dataclass(frozen=True)
class Falling(Temperature):
    """It falls by the share of candidates that trained."""

    step: float = 0.1

    def next(self, ended: Generation) -> float:
        return ended.temperature - self.step * ended.trained / ended.candidates


@dataclass(frozen=True)
class Half(Fitness):
    """Half of the lowest loss."""

    def of(self, losses: Sequence[float]) -> float:
        return min(losses) / 2


@dataclass(frozen=True)
class Size(Descriptor):
    """The number of parameters."""

    def describe(self, profile: Profile) -> float:
        return float(profile.parameters)


@dataclass(frozen=True)
class Rows(Archive):
    """Niches in a row."""

    def centroids(self, niches: int, axes: int) -> Sequence[Sequence[float]]:
        return [[(niche + 0.5) / niches] * axes for niche in range(niches)]
