"""The protocols of parts that decide results: a class for each kind, to be extended, and what its methods get.

A part is a frozen dataclass; its fields are its settings, each an int, a float, a bool or a text. Each decision is made
by a fresh process that has imported nothing but the part and the modules of `ALLOWED`: nothing is kept between calls,
and no clock and no file is at hand. What is drawn comes from `rng`, so that the same search decides alike everywhere.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol, TypeVar

import numpy as np

from tacevo.profile import Profile

#: The modules that a part that decides may import beside its own. Their results follow from their arguments alone.
ALLOWED = frozenset(
    {"__future__", "abc", "ast", "bisect", "collections", "copy", "dataclasses", "difflib", "enum", "fractions"}
    | {"functools", "hashlib", "heapq", "itertools", "json", "keyword", "math", "numpy", "operator", "re", "statistics"}
    | {"string", "tacevo.parts", "tacevo.profile", "textwrap", "tokenize", "typing"}
)


def is_allowed(module: str) -> bool:
    """Answer whether a part that decides may import a module, by its dotted name."""
    names = module.split(".")
    return any(".".join(names[:depth]) in ALLOWED for depth in range(1, len(names) + 1))


class Candidate(Protocol):
    """A network that trained, as a part sees it; nothing of it can be set."""

    @property
    def id(self) -> str:
        """Generation and slot, e.g. `g03s07`."""

    @property
    def source(self) -> str:
        """The text of its class."""

    @property
    def fitness(self) -> float:
        """The fitness by which the candidate competes; lower is better."""

    @property
    def losses(self) -> tuple[float, ...]:
        """The validation losses, one an epoch: cross-entropy in nats, or mean squared error of scaled values."""

    @property
    def parameters(self) -> int:
        """The number of values that the candidate learns."""

    @property
    def flops(self) -> int:
        """Forward FLOPs of one image in training mode."""

    @property
    def parents(self) -> tuple[str, ...]:
        """The ids of its parents: none, one of a mutation, two of a crossover."""

    @property
    def curiosity(self) -> float:
        """The mean curiosity of itself and its mutations: 0.5, or above 1 where the archive took the network."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Population:
    """The candidates from which the parents of a generation are chosen."""

    #: The generation that is planned, from 1.
    generation: int
    #: All candidates that trained, by id, in the order of their slots; at least one, the baseline.
    candidates: Mapping[str, Candidate]
    #: The candidates that the network archive holds, in the order of their niches.
    elites: Sequence[Candidate]


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """A prompt configuration in the prompt archive, and what came of it."""

    #: Index of the instruction.
    prompt: int
    #: T_g, in [0, 1].
    temperature: float
    #: r(s): whether the network archive took the child.
    inserted: bool
    curiosity: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PromptHistory:
    """The knowledge of a search about its instructions."""

    #: The trials that the prompt archive holds, in the order of their niches.
    trials: Sequence[Trial]
    #: The number of children of each instruction, and the sum of log(loss of the child / loss of its parent); one that
    #: does not train counts as 1.
    changes: Mapping[int, tuple[int, float]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Generation:
    """A generation that has ended, as a rule of the temperature sees it."""

    #: The number of the generation, from 1.
    number: int
    #: T_g, in [0, 1].
    temperature: float
    #: f*_g and f*_(g-1): the archive's best fitness after this generation and before it; lower is better.
    best: float
    best_before: float
    #: The number of candidates that it asked for, of those that trained, and of those that the archive took.
    candidates: int
    trained: int
    inserted: int


C = TypeVar("C", bound=Candidate)


class Parents:
    """Chooses parents (paper, Algorithm 1, line 2)."""

    #: Whether candidates have parents at all; without, each is drawn at random (by `llm=grammar` only).
    has_parents: ClassVar[bool] = True
    #: Whether a crossover can have two different parents.
    crosses: ClassVar[bool] = True
    #: Whether it counts elites, of which an archive without niches has as many as it keeps networks.
    counts_elites: ClassVar[bool] = False
    #: Whether it has a `pool` of its own; nobody sets this.
    chooses_pool: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        """Note whether the class says itself who may be drawn."""
        cls.chooses_pool = cls.pool is not Parents.pool

    def pool(self, population: Population) -> Sequence[Candidate]:
        """Return the candidates of which parents are drawn in one generation; by default the elites.

        With a single one, or none, which stands for the baseline, the generation mutates.
        """
        return population.elites

    def draw(self, pool: Sequence[C], number: int, rng: np.random.Generator) -> Sequence[C]:
        """Draw so many different candidates of the pool, which has at least as many: 1 for a mutation, 2 to cross."""
        raise NotImplementedError


class Prompts:
    """Draws the instruction of a mutation (paper, Algorithm 1, line 3)."""

    #: Whether what came of an instruction competes in the prompt archive.
    records: ClassVar[bool] = True

    def draw(self, history: PromptHistory, pool: Sequence[int], rng: np.random.Generator) -> int:
        """Draw one of the pool: indices of instructions, rising, at least one."""
        raise NotImplementedError


class Temperature:
    """Moves the sampling temperature (paper, Algorithm 1, line 9)."""

    def next(self, ended: Generation) -> float:
        """Return the temperature of the next generation; it is brought into [0, 1]."""
        raise NotImplementedError


class Fitness:
    """Says what the fitness of a training is."""

    def of(self, losses: Sequence[float]) -> float:
        """Return a finite number, lower is better, of the validation losses: one an epoch, at least one."""
        raise NotImplementedError


class Descriptor:
    """Measures a network for an axis of the network archive."""

    def describe(self, profile: Profile) -> float:
        """Return a finite number that depends on what the probe measured alone."""
        raise NotImplementedError


class Archive:
    """Says where the niches of the network archive are: each network competes for that of the nearest centroid."""

    #: Whether there are niches; in one of ours there are none, and the best of all are kept.
    has_niches: ClassVar[bool] = True

    def centroids(self, niches: int, axes: int) -> Sequence[Sequence[float]]:
        """Return the centroid of each niche, `niches` points of so many coordinates in [0, 1]: of a grid, a CVT."""
        raise NotImplementedError
