"""What a search decided, one record for each line of its ledger.

A field without a default is in every line; one with a default only where it differs from it. Lines that were written
before a field existed therefore keep their bytes.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from tacevo.records import STRICT, DataFacts, Json, Operator, Reason, Stage
from tacevo.rules import FIRST, Rules
from tacevo.search.archive import AddStatus, Bounds


@dataclass(frozen=True, slots=True, kw_only=True)
class RunLine:
    """The first line: all that the results of a run follow from."""

    __pydantic_config__ = STRICT

    #: Layout of the ledger.
    schema: int
    #: The part of the configuration that decides results (`tacevo.config.identity`).
    config: dict[str, Json]
    #: SHA-256 of the task's texts.
    task: str
    data: DataFacts
    #: SHA-256 of the centroids of both archives.
    centroids: str
    rules: Rules = FIRST
    kind: Literal["run"] = "run"


@dataclass(frozen=True, slots=True, kw_only=True)
class RulesLine:
    """The generations from here on were made under other rules."""

    __pydantic_config__ = STRICT

    generation: int
    rules: Rules
    kind: Literal["rules"] = "rules"


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairedAnswer:
    """An answer that the gate rejected and that was sent back."""

    __pydantic_config__ = STRICT

    #: SHA-256 of what the model said.
    answer: str
    stage: Stage
    reason: Reason
    #: Sampling settings that the request was sent without.
    dropped: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class CandidateLine:
    """What became of one slot of a generation."""

    __pydantic_config__ = STRICT

    generation: int
    slot: int
    id: str
    operator: Operator
    parents: tuple[str, ...]
    #: Number of the instruction; None for the baseline and for crossovers.
    prompt: int | None
    #: SHA-256 of the request, and the temperature that it asks for; None for the baseline.
    request: str | None
    temperature: float | None
    #: SHA-256 of what the model said; None for the baseline.
    answer: str | None
    dropped: tuple[str, ...] = ()
    repairs: tuple[RepairedAnswer, ...] = ()
    #: SHA-256 of the source; None where the gate rejected the candidate.
    source: str | None = None
    #: Where and why the candidate was rejected; None of a trained one.
    stage: Stage | None = None
    reason: Reason | None = None
    #: Key of the training in its store, and what the probe measured; None where the gate rejected the candidate.
    evaluation: str | None = None
    parameters: int | None = None
    flops: int | None = None
    entropy: float | None = None
    variation: float | None = None
    density: float | None = None
    arch_div: float | None = None
    eff_ratio: float | None = None
    #: Kernels whose bits differ between CPUs.
    not_portable: tuple[str, ...] = ()
    #: What the training gave, and what the archives did with it; None of a rejected candidate.
    fitness: float | None = None
    train_losses: tuple[float, ...] | None = None
    validation_losses: tuple[float, ...] | None = None
    predictions: str | None = None
    weights: str | None = None
    not_deterministic: tuple[str, ...] = ()
    niche: int | None = None
    status: AddStatus | None = None
    curiosity: float | None = None
    prompt_niche: int | None = None
    prompt_status: AddStatus | None = None
    kind: Literal["candidate"] = "candidate"


@dataclass(frozen=True, slots=True, kw_only=True)
class GenerationLine:
    """How a generation ended."""

    __pydantic_config__ = STRICT

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
    kind: Literal["generation"] = "generation"


Line = RunLine | RulesLine | CandidateLine | GenerationLine

_KINDS: Mapping[str, type[Line]] = {
    "run": RunLine,
    "rules": RulesLine,
    "candidate": CandidateLine,
    "generation": GenerationLine,
}


def line_kind(entry: Mapping[str, Json]) -> type[Line] | None:
    """Return the class of a line that is read as JSON; None where a search writes no such line."""
    return _KINDS.get(str(entry.get("kind")))
