"""The choice of a generation's parents: the paper's rules, and those of controls; pure (`tacevo.parts.Parents`)."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from tacevo.evolution.prompts import draw_weighted
from tacevo.parts import Candidate, Parents, Population

C = TypeVar("C", bound=Candidate)


@dataclass(frozen=True)
class Uniform(Parents):
    """Elites, all alike."""

    def draw(self, pool: Sequence[C], number: int, rng: np.random.Generator) -> tuple[C, ...]:
        """Draw different candidates; raises ValueError where there are fewer."""
        return _drawn(pool, number, lambda left: int(rng.integers(len(left))))


@dataclass(frozen=True)
class Best(Uniform):
    """The fittest elites, alike."""

    #: The number of elites that are drawn from; at least as many as are drawn.
    best: int

    def draw(self, pool: Sequence[C], number: int, rng: np.random.Generator) -> tuple[C, ...]:
        """Draw different candidates among the `best` fittest; raises ValueError where there are fewer."""
        ranked = sorted(pool, key=lambda elite: (elite.fitness, elite.id))
        return super().draw(ranked[: max(self.best, number)], number, rng)


@dataclass(frozen=True)
class Curious(Parents):
    """Elites, in proportion to their curiosity."""

    def draw(self, pool: Sequence[C], number: int, rng: np.random.Generator) -> tuple[C, ...]:
        """Draw different candidates; raises ValueError where there are fewer."""
        return _drawn(pool, number, lambda left: draw_weighted([elite.curiosity for elite in left], rng))


@dataclass(frozen=True)
class Trained(Uniform):
    """A control: all candidates that trained, alike."""

    def pool(self, population: Population) -> Sequence[Candidate]:
        """Return all candidates."""
        return tuple(population.candidates.values())


@dataclass(frozen=True)
class BestK(Uniform):
    """A control: the fittest candidates, as many as there are elites, alike."""

    counts_elites = True

    def pool(self, population: Population) -> Sequence[Candidate]:
        """Return the fittest candidates."""
        return fittest(population.candidates.values(), len(population.elites))


@dataclass(frozen=True)
class Baseline(Uniform):
    """A control: the baseline alone."""

    crosses = False

    def pool(self, population: Population) -> Sequence[Candidate]:
        """Return nobody, which stands for the baseline."""
        return ()


@dataclass(frozen=True)
class Nobody(Uniform):
    """A control: every candidate is drawn at random."""

    has_parents = crosses = False


def fittest(candidates: Iterable[C], count: int) -> tuple[C, ...]:
    """Return the candidates of least loss, best first, at most `count`.

    Of several exactly as fit only the first one counts, as in an archive without niches (`archive.TopK`): a network
    that comes twice is one network.
    """
    first: dict[float, C] = {}
    for candidate in candidates:
        first.setdefault(candidate.fitness, candidate)
    return tuple(first[fitness] for fitness in sorted(first)[:count])


def _drawn(pool: Sequence[C], number: int, draw: Callable[[list[C]], int]) -> tuple[C, ...]:
    """Draw different candidates, one after the other, each by its index among those that are left."""
    if len(pool) < number:
        raise ValueError(f"drawing {number} parents needs as many candidates; got {len(pool)}")
    left = list(pool)
    return tuple(left.pop(draw(left)) for _ in range(number))
