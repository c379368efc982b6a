"""What a search decided, one record for each line of its ledger; and the rules that the lines were made under.

A field without a default is in every line; one with a default only where it differs from it. Lines that were written
before a field existed therefore keep their bytes.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import pairwise
from typing import Literal, Self, TypeVar

from tacevo.errors import RunError
from tacevo.records import DataFacts, Json, Operator, Reason, Record, Stage, Training
from tacevo.rules import FIRST, Rules
from tacevo.search.archive import AddStatus, Bounds
from tacevo.typed import FreeJson

T = TypeVar("T", bound="TrainedLine")


@dataclass(frozen=True, slots=True, kw_only=True)
class RunLine(Record):
    """The first line: all that the results of a run follow from."""

    #: Layout of the ledger.
    schema: int
    #: The part of the configuration that decides results (`tacevo.config.identity`).
    config: dict[str, FreeJson]
    #: SHA-256 of the task's texts.
    task: str
    data: DataFacts
    #: SHA-256 of the centroids of both archives.
    centroids: str
    rules: Rules = FIRST
    kind: Literal["run"] = "run"


@dataclass(frozen=True, slots=True, kw_only=True)
class RulesLine(Record):
    """An era begins: the generations from here on were made under these rules."""

    generation: int
    rules: Rules
    kind: Literal["rules"] = "rules"


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairedAnswer(Record):
    """An answer that the gate rejected and that was sent back."""

    #: SHA-256 of what the model said.
    answer: str
    stage: Stage
    reason: Reason
    #: Sampling settings that the request was sent without.
    dropped: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class SeedLine(Record):
    """One of several trainings of a candidate, each with a seed of its own."""

    #: The number of its training seed.
    seed: int
    #: Key of the training in its store.
    evaluation: str
    train_losses: tuple[float, ...]
    #: The last one is the loss of which the fitness is the median.
    validation_losses: tuple[float, ...]
    predictions: str
    weights: str
    not_deterministic: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainedLine(Record):
    """What came of the trainings of a slot."""

    generation: int
    slot: int
    #: Of the candidate.
    id: str
    #: SHA-256 of the source; None where the gate rejected the candidate.
    source: str | None = None
    #: Where and why the candidate was rejected; None of a trained one.
    stage: Stage | None = None
    reason: Reason | None = None
    #: Key of the training in its store; None where the gate rejected the candidate.
    evaluation: str | None = None
    #: Kernels whose bits differ between CPUs.
    not_portable: tuple[str, ...] = ()
    #: What the training gave; None of a rejected candidate.
    fitness: float | None = None
    train_losses: tuple[float, ...] | None = None
    validation_losses: tuple[float, ...] | None = None
    predictions: str | None = None
    weights: str | None = None
    not_deterministic: tuple[str, ...] = ()
    #: The number of the training seed, from 0, that evaluation, fitness, losses and digests are of: of several seeds
    #: the one with the median loss, or the first that failed.
    seed: int = 0
    #: All trainings in the order of their seeds, where there are several; () of a rejected candidate.
    seeds: tuple[SeedLine, ...] = ()

    def by_seed(self) -> tuple[Self, ...]:
        """Return a line for each training that this one records, with what is that training's."""
        if not self.seeds:
            return (self,)
        names = [field.name for field in fields(SeedLine)]
        return tuple(replace(self, **{name: getattr(one, name) for name in names}) for one in self.seeds)


@dataclass(frozen=True, slots=True, kw_only=True)
class CandidateLine(TrainedLine):
    """What became of one slot of a generation that asked for a network."""

    operator: Operator
    parents: tuple[str, ...]
    #: Number of the instruction; None for crossovers, and where no model was asked.
    prompt: int | None
    #: SHA-256 of the request, and the temperature that it asks for; None of the baseline and of a given network.
    request: str | None
    temperature: float | None
    #: SHA-256 of what the model said; None where none was asked.
    answer: str | None
    dropped: tuple[str, ...] = ()
    repairs: tuple[RepairedAnswer, ...] = ()
    #: What the probe measured; None where the gate rejected the candidate.
    parameters: int | None = None
    flops: int | None = None
    entropy: float | None = None
    variation: float | None = None
    density: float | None = None
    arch_div: float | None = None
    eff_ratio: float | None = None
    #: What the archives did with it; None of a rejected candidate.
    niche: int | None = None
    status: AddStatus | None = None
    curiosity: float | None = None
    prompt_niche: int | None = None
    prompt_status: AddStatus | None = None
    kind: Literal["candidate"] = "candidate"

    @property
    def sent_temperature(self) -> float | None:
        """The temperature that the request was sent with; None where none was, as for the baseline."""
        return None if "temperature" in self.dropped else self.temperature


@dataclass(frozen=True, slots=True, kw_only=True)
class ReevaluationLine(TrainedLine):
    """What became of one slot of a generation that trained an elite again; `id` is the elite's."""

    #: The median of all losses of its source, by which it competes from now on; None where a training of it failed.
    estimate: float | None = None
    #: Whether it is still the elite of its niche.
    kept: bool = False
    kind: Literal["reevaluation"] = "reevaluation"


@dataclass(frozen=True, slots=True, kw_only=True)
class GenerationLine(Record):
    """How a generation ended."""

    generation: int
    #: T_g, and T_{g+1}.
    temperature: float
    next_temperature: float
    candidates: int
    #: Candidates whose first answer was trained, as the paper counts; and those trained after a repair.
    trained: int
    #: Best fitness of the archive, and best and median fitness of the generation; None where there is none.
    best: float | None
    generation_best: float | None
    generation_median: float | None
    coverage: float
    qd_score: float
    prompt_coverage: float
    bounds: Bounds | None
    #: SHA-256 of the occupants of both archives.
    archive: str
    prompt_archive: str
    #: None where no answer was sent back.
    repaired: int | None = None
    #: Slots that trained an elite again; they are not among the candidates. None where there were none.
    reevaluated: int | None = None
    kind: Literal["generation"] = "generation"


#: What a search itself commits.
SearchLine = CandidateLine | ReevaluationLine | GenerationLine

Line = RunLine | RulesLine | SearchLine

_KINDS: Mapping[str, type[Line]] = {
    "run": RunLine,
    "rules": RulesLine,
    "candidate": CandidateLine,
    "reevaluation": ReevaluationLine,
    "generation": GenerationLine,
}


def line_kind(entry: Mapping[str, Json]) -> type[Line] | None:
    """Return the class of a line that is read as JSON; None where a search writes no such line."""
    return _KINDS.get(str(entry.get("kind")))


def with_training(line: T, training: Training) -> T:
    """Return a line with what its training gave."""
    return replace(
        line,
        fitness=training.fitness,
        train_losses=training.train_losses,
        validation_losses=training.validation_losses,
        predictions=training.predictions_sha256,
        weights=training.weights_sha256,
        not_deterministic=training.not_deterministic,
    )


def seed_lines(trainings: Mapping[int, Training], key: Callable[[int], str]) -> tuple[SeedLine, ...]:
    """Return the lines of several trainings, by the numbers of their seeds; none of a single one."""
    if len(trainings) < 2:
        return ()
    return tuple(
        SeedLine(
            seed=seed,
            evaluation=key(seed),
            train_losses=training.train_losses,
            validation_losses=training.validation_losses,
            predictions=training.predictions_sha256,
            weights=training.weights_sha256,
            not_deterministic=training.not_deterministic,
        )
        for seed, training in trainings.items()
    )


def eras_of(lines: Sequence[Line]) -> tuple[RulesLine, ...]:
    """Return where each of a run's eras begins, in order: the first at generation 0, under the header's rules.

    A run that was continued under later rules has more than one era.

    Raises:
        RunError: the ledger does not begin with a header, or an era does not follow the one before it.
    """
    eras: list[RulesLine] = []
    for line in lines:
        if isinstance(line, RunLine):
            eras.append(RulesLine(generation=0, rules=line.rules))
        elif not eras:
            break
        elif isinstance(line, RulesLine):
            eras.append(line)
    if not eras or any(after.generation <= before.generation for before, after in pairwise(eras)):
        generations = [era.generation for era in eras]
        expected = "a header, and then rules that begin at later and later generations"
        raise RunError(f"rules from generations {generations}", place="ledger.jsonl", expected=expected)
    return tuple(eras)


def eras_in_words(eras: Sequence[RulesLine]) -> str:
    """Write the numbers that a run began with, and from which generation on which of them changed."""
    begun, *_ = eras
    words = [", ".join(f"{part} {number}" for part, number in asdict(begun.rules).items())]
    for before, era in pairwise(eras):
        changed = asdict(era.rules).items() - asdict(before.rules).items()
        words.append(f"from generation {era.generation} " + ", ".join(f"{part} {to}" for part, to in sorted(changed)))
    return "; ".join(words)


def by_rules(lines: Sequence[Line]) -> Iterator[tuple[Rules, TrainedLine]]:
    """Yield every line of a candidate, or of its re-evaluation, with the rules that it was made under."""
    rules = FIRST
    for line in lines:
        if isinstance(line, TrainedLine):
            yield rules, line
        elif not isinstance(line, GenerationLine):
            rules = line.rules
