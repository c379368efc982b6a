"""The decisions of a search, one record for each line of its ledger; and the sums over such lines; pure.

A field without a default is in every line; one with a default only where it differs from it. Lines that were written
before a field existed therefore keep their bytes.
"""

import hashlib
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

from tacevo.choices import Carrier, Effort
from tacevo.evolution.archive import AddStatus, AxisBounds
from tacevo.parts import Fitness
from tacevo.records import Operator, Reason, Record, Rejection, Stage, Training

#: The sampling setting that a search adapts.
TEMPERATURE = "temperature"

#: Reasons of candidates that are not what they say: they misreport their size, mode or optimiser.
MISREPORTING = (
    Reason.redefines_module,
    Reason.changes_its_weights,
    Reason.changes_its_mode,
    Reason.hidden_parameters,
    Reason.depends_on_batch,
    Reason.learns_by_itself,
)


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
class CandidateLine(Record):
    """The line of one slot of a generation: what became of it."""

    generation: int
    slot: int
    id: str
    #: SHA-256 of the source; None where the gate rejected the candidate.
    source: str | None = None
    #: The stage at which the candidate was rejected, and the reason; None of one that was not.
    stage: Stage | None = None
    reason: Reason | None = None
    #: Key of the training in its store; None where nothing was trained.
    evaluation: str | None = None
    #: Kernels whose bits differ between CPUs.
    not_portable: tuple[str, ...] = ()
    #: The fitness and further results of the training; None of a candidate that was rejected or skipped.
    fitness: float | None = None
    train_losses: tuple[float, ...] | None = None
    validation_losses: tuple[float, ...] | None = None
    predictions: str | None = None
    weights: str | None = None
    not_deterministic: tuple[str, ...] = ()
    #: Whether the steps of a training on a GPU were recorded once and replayed.
    captured: bool | None = None
    operator: Operator
    parents: tuple[str, ...]
    #: Number of the instruction; None for crossovers, and where no model was asked.
    prompt: int | None
    #: SHA-256 of the request, and its temperature T; None of the baseline and of a given network.
    request: str | None
    temperature: float | None
    #: The carrier of T, and what it carried: the number of the sentence or of the effort, from 1, and the effort; None
    #: where it carried none.
    carrier: Carrier = Carrier.parameter
    level: int | None = None
    effort: Effort | None = None
    #: SHA-256 of what the model said; None where none was asked.
    answer: str | None
    dropped: tuple[str, ...] = ()
    repairs: tuple[RepairedAnswer, ...] = ()
    #: The number of parameters and further measurements of the probe; None where the gate rejected the candidate.
    parameters: int | None = None
    flops: int | None = None
    #: See `Profile`.
    learnt_outside: int = 0
    extra_flops: int = 0
    entropy: float | None = None
    variation: float | None = None
    density: float | None = None
    arch_div: float | None = None
    eff_ratio: float | None = None
    #: The values of the archive's axes that a user brought, in their order; empty of a candidate that did not train.
    measures: tuple[float, ...] = ()
    #: Whether a surrogate judged it among the worst, so that it was not trained.
    skipped: bool = False
    #: The model that was asked, in a search with several; None in all others, and where no model was asked.
    model: str | None = None
    #: The candidate's niche, and what the archives did with it; None of a candidate that was rejected or skipped.
    niche: int | None = None
    status: AddStatus | None = None
    curiosity: float | None = None
    prompt_niche: int | None = None
    prompt_status: AddStatus | None = None
    kind: Literal["candidate"] = "candidate"

    LATER: ClassVar[frozenset[str]] = frozenset({"skipped", "measures", "carrier", "level", "effort", "model"})

    @property
    def sent_temperature(self) -> float | None:
        """The temperature T, where it reached the model, be it by words or effort; None where it did not.

        Ledgers of core 1 do not say what was dropped from a request: of these it is the planned one.
        """
        is_carried = self.carrier is Carrier.parameter or self.level is not None
        return self.temperature if is_carried and TEMPERATURE not in self.dropped else None

    @property
    def first_rejection(self) -> tuple[Stage, Reason] | None:
        """The stage at which the first answer was rejected, and the reason; None where it was not."""
        first = self.repairs[0] if self.repairs else self
        return (first.stage, first.reason) if first.stage and first.reason else None

    @property
    def inserted(self) -> bool:
        """Whether the network archive took the candidate when it came."""
        return self.status in {AddStatus.new, AddStatus.improved}


@dataclass(frozen=True, slots=True, kw_only=True)
class GenerationLine(Record):
    """The line that ends a generation."""

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
    bounds: AxisBounds | None
    #: SHA-256 of the occupants of both archives.
    archive: str
    prompt_archive: str
    #: The number of candidates that trained after a repair; None where no answer was sent back.
    repaired: int | None = None
    #: Candidates whose first answer a surrogate skipped; None where there were none.
    skipped: int | None = None
    kind: Literal["generation"] = "generation"

    LATER: ClassVar[frozenset[str]] = frozenset({"skipped"})

    @property
    def trainable(self) -> float:
        """The part of the candidates, at least one, whose first answer was trained, or only skipped; in [0, 1]."""
        return (self.trained + (self.skipped or 0)) / self.candidates


@dataclass(frozen=True, slots=True, kw_only=True)
class GateStage:
    """One stage of the gate over a whole run."""

    stage: Stage
    rejected: int
    #: First answers that no stage so far rejected, skipped ones among them; the baseline is not an answer.
    left: int
    #: The share `left` of all first answers, in [0, 1]; None where nothing was asked.
    left_share: float | None
    #: The reasons of rejections with their counts, most frequent first.
    reasons: tuple[tuple[Reason, int], ...]


#: The lines that a search itself commits.
SearchLine = CandidateLine | GenerationLine


def source_hash(source: str) -> str:
    """Return what lines name a source by: its SHA-256."""
    return hashlib.sha256(source.encode()).hexdigest()


def of_training(training: Training) -> dict[str, Any]:
    """Return what a training gave by the names that lines have for it."""
    return {
        "train_losses": training.train_losses,
        "validation_losses": training.validation_losses,
        "predictions": training.predictions_sha256,
        "weights": training.weights_sha256,
        "not_deterministic": training.not_deterministic,
        "captured": training.captured,
    }


def with_result(
    line: CandidateLine, result: Training | Rejection, *, evaluation: str | None, rule: Fitness
) -> CandidateLine:
    """Return a line with what gate and training found; `evaluation` names the training, where there was one."""
    line = replace(line, evaluation=evaluation)
    if isinstance(result, Rejection):
        return replace(line, stage=result.stage, reason=result.reason)
    return replace(line, fitness=rule.of(result.validation_losses), **of_training(result))


def training_flops(trained: Iterable[tuple[str, int]], *, images: int, epochs: int) -> int:
    """Add up the FLOPs of trainings: forward FLOPs of one image x images x epochs, each network once.

    The backward pass is not counted: a training takes about three times as many, whatever the network. A network that
    comes again is recalled and not trained again.

    Args:
        trained: what names a network (its source, or the hash of it), and the forward FLOPs that its probe counted for
            one image in training mode, >= 0. Trainings that failed are not among them: where they stopped is not known.
        images: of the training split, in every epoch.
        epochs: of every training.
    """
    return images * epochs * sum(dict(trained).values())


def trained_networks(lines: Iterable[CandidateLine]) -> list[tuple[str, int]]:
    """Return the networks of a ledger that trained, for `training_flops`, by the hash of their sources."""
    return [(str(line.source), (line.flops or 0) + line.extra_flops) for line in lines if line.fitness is not None]


def why_not_sent(setting: str, *, thinks: bool) -> str:
    """Say why a sampling setting was not sent; `thinks`: whether the model was asked to think."""
    by_thinking = thinks and setting == TEMPERATURE
    return "the model is to think (llm.thinking)" if by_thinking else "the model refuses it"


def not_sent(dropped: Sequence[Collection[str]], *, thinks: bool = False) -> dict[str, str]:
    """Say which sampling settings were not sent, as in `temperature was not sent: the model refuses it`.

    What was dropped are the settings that each request of a run was sent without; `thinks` is as of `why_not_sent`.
    Return the words by setting, in the order of names, with the number of requests where it is not all of them.
    """
    missed = Counter(setting for settings in dropped for setting in settings)
    parts = {
        setting: "" if missed[setting] == len(dropped) else f" with {missed[setting]} of {len(dropped)} requests"
        for setting in sorted(missed)
    }
    return {
        setting: f"{setting} was not sent{part}: {why_not_sent(setting, thinks=thinks)}"
        for setting, part in parts.items()
    }


def gate_stages(lines: Iterable[CandidateLine]) -> tuple[GateStage, ...]:
    """Count where first answers were rejected; what the last stage leaves was trained or skipped.

    The baseline and given networks are not answers. An answer that was rejected and then repaired counts as rejected,
    as the paper discards it.
    """
    answers = [line for line in lines if line.request is not None]
    counts = Counter(line.first_rejection for line in answers)
    left = len(answers)
    stages = []
    for stage in Stage:
        reasons = {entry[1]: count for entry, count in counts.items() if entry and entry[0] is stage}
        rejected = sum(reasons.values())
        left -= rejected
        stages.append(
            GateStage(
                stage=stage,
                rejected=rejected,
                left=left,
                left_share=left / len(answers) if answers else None,
                reasons=tuple(sorted(reasons.items(), key=lambda entry: (-entry[1], entry[0]))),
            )
        )
    return tuple(stages)


def skipped_note(lines: Iterable[CandidateLine], did: str = "trained") -> list[str]:
    """Return a line with how many of the first answers that the gate left were skipped; no line where none was.

    `did` is what became of the others: `trained`, or `looked up` in a table.
    """
    count = sum(line.skipped for line in lines if not line.repairs)
    return [f"Skipped, and not {did}, of what is left (proposals.skipped): {count}."] if count else []


def misreported(stages: Iterable[GateStage]) -> list[str]:
    """Return a line with how many first answers were rejected for misreporting themselves; no line where none was."""
    counts = dict.fromkeys(MISREPORTING, 0)
    for reason, count in (entry for stage in stages for entry in stage.reasons):
        if reason in counts:
            counts[reason] += count
    reasons = ", ".join(f"{reason} {count}" for reason, count in counts.items() if count)
    return (
        [f"Rejected for misreporting themselves (docs/gate.md): {sum(counts.values())} ({reasons})."] if reasons else []
    )
