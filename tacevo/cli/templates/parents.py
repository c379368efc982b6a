"""Parents: who the parents of the next candidates are."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from tacevo.parts import Candidate, Parents, Population

C = TypeVar("C", bound=Candidate)


@dataclass(frozen=True)
class Mine(Parents):
    """The fittest few of all that trained."""

    #: How many.
    k: int = 5

    def pool(self, population: Population) -> Sequence[Candidate]:
        """Return those of whom parents are drawn."""
        return sorted(population.candidates.values(), key=lambda one: one.fitness)[: self.k]

    def draw(self, pool: Sequence[C], number: int, rng: np.random.Generator) -> Sequence[C]:
        """Draw so many different ones, 1 or 2, all alike."""
        return [pool[index] for index in rng.choice(len(pool), number, replace=False)]
