"""The plan of a search, the state that its next step depends on, and the protocols of those who take its lines."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from tacevo.evolution.archive import NetworkArchive, PersistentMap, Tessellation, TopK
from tacevo.evolution.development import Outcome
from tacevo.evolution.fitness import Last
from tacevo.evolution.lines import SearchLine, training_flops
from tacevo.evolution.models import Gains
from tacevo.evolution.prompts import PromptArchive
from tacevo.evolution.proposals import Candidate, Known, Settings
from tacevo.parts import Descriptor, Fitness, Temperature
from tacevo.profile import Admitted, Profile
from tacevo.records import Rejection, Task


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """A bound on the trainings of a search."""

    #: The work at which the search ends, in FLOPs as `training_flops` counts them; > 0.
    flops: float
    #: Images in one epoch of a training, and epochs of one.
    images: int
    epochs: int

    def is_spent(self, trained: Iterable[tuple[str, int]]) -> bool:
        """Return whether trainings have reached the bound; for `trained` see `training_flops`."""
        return training_flops(trained, images=self.images, epochs=self.epochs) >= self.flops


class Skipping(Protocol):
    """Decides which candidates are not trained, by the networks that were, as `tacevo.evolution.surrogate` does."""

    def features(self, profile: Profile) -> Mapping[str, float]:
        """Return what it sees of a network; a trained one keeps it."""

    def skips(self, trained: Iterable[Candidate]) -> Callable[[Admitted], bool]:
        """Return what decides, in one generation, whether an admitted candidate is skipped."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """The plan of a search: the task, and every setting that the fold reads."""

    task: Task
    settings: Settings
    generations: int
    #: Mutations of the baseline in generation 0.
    initial: int
    networks: Tessellation | TopK
    prompts: Tessellation
    #: The network archive to begin with: empty, with fixed bounds or none.
    archive: NetworkArchive
    #: The descriptors that the archive's axes measure, by name.
    axes: Mapping[str, Descriptor]
    temperature: Temperature
    temperature_start: float
    #: The number of times that an answer is sent back which the gate rejected.
    repairs: int = 0
    #: The setting that names the networks of a task that are given, for errors.
    given_by: str = "networks"
    #: The budget that ends the search before generation G; None without one.
    budget: Budget | None = None
    #: The rule that makes the fitness of a training from its losses.
    fitness: Fitness = field(default_factory=Last)
    #: The rule for which candidates are not trained; None where all are.
    skipping: Skipping | None = None
    #: Whether a line names the sampling settings that were not sent; the ledgers of earlier releases do not.
    names_dropped: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchState:
    """Everything the next step depends on."""

    #: The next generation to run.
    generation: int
    temperature: float
    networks: NetworkArchive
    prompts: PromptArchive = field(default_factory=PromptArchive)
    #: Every evaluated candidate, by id.
    candidates: PersistentMap[str, Candidate] = field(default_factory=PersistentMap)
    #: f*: the best fitness of the network archive.
    best: float = math.inf
    #: What became of the candidates of the generation under way, or else of the last one, that were rejected.
    rejections: tuple[Rejection, ...] = ()
    #: What came of the answers of each model, by its name; empty where a search asks one model.
    gains: Mapping[str, Gains] = field(default_factory=dict)

    @property
    def known(self) -> Known:
        """What the next generation's requests may follow from, beside networks and prompts."""
        return Known(rejections=self.rejections, gains=self.gains)

    def is_past(self, plan: Plan) -> bool:
        """Return whether the search is at its end: after generation G, or after the one that spent its budget."""
        trained = ((one.source, one.flops) for one in self.candidates.values())
        return self.generation > plan.generations or (plan.budget is not None and plan.budget.is_spent(trained))


class LedgerWriter(Protocol):
    """The writer that takes the lines of a search (`tacevo.storage.ledger`)."""

    def commit(self, line: SearchLine) -> None:
        """Append a line, or compare it with the one that stands in its place."""


class Observer(Protocol):
    """An observer of a search; nothing it does may change one."""

    def developed(self, outcome: Outcome) -> None:
        """Take an outcome before it is committed."""

    def committed(self, line: SearchLine, state: SearchState) -> None:
        """Take a line of the ledger after it was committed, and the state that results."""
