"""What MLflow shows of a run: pure functions from its configuration and ledger lines to params and metrics."""

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

from tacevo.choices import Axis
from tacevo.costs import Spending, total
from tacevo.evolution.lines import CandidateLine, GenerationLine
from tacevo.records import Instruction, Json, Operator
from tacevo.storage.canonical import leaves

#: The longest param, in characters: older MLflow servers refuse more.
LONGEST_PARAM = 500

#: The longest description of a run, in characters, for the same reason.
_LONGEST_NOTE = 5_000

#: The environment variable in which MLflow itself looks for a tracking URI.
URI_VARIABLE = "MLFLOW_TRACKING_URI"

_GENERATION_METRICS = (
    "best",
    "generation_best",
    "generation_median",
    "coverage",
    "qd_score",
    "prompt_coverage",
    "candidates",
    "trained",
    "repaired",
    "reevaluated",
    "temperature",
)

_CANDIDATE_METRICS = (
    "fitness",
    *Axis,
    "entropy",
    "density",
    "variation",
    "flops",
    "parameters",
    "niche",
    "curiosity",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Measure:
    """One value of a metric."""

    key: str
    value: float
    #: The generation of a search's metrics, the epoch or seed of a loss, 0 of a candidate's other metrics.
    step: int


def config_params(config: Mapping[str, Json]) -> dict[str, str]:
    """Flatten a nested configuration: `{"llm": {"model": "m"}}` becomes `{"llm.model": "m"}`; lists become JSON."""
    return {key: shorten(_text(value)) for key, value in leaves(config)}


def candidate_params(line: CandidateLine, instructions: Sequence[Instruction]) -> dict[str, str]:
    """Return how a candidate was asked for and, if rejected, where and why; what does not apply is left out."""
    instruction = None if line.prompt is None else instructions[line.prompt]
    crossover = "crossover" if line.operator is Operator.crossover else None
    shown = {
        **{key: getattr(line, key) for key in ("operator", "generation", "slot", "stage", "reason")},
        "temperature": line.sent_temperature,
        "dropped": ",".join(line.dropped) or None,
        "parents": ",".join(line.parents) or None,
        "repairs": len(line.repairs) or None,
        "instruction": instruction.id if instruction else crossover,
        "instruction_text": instruction.text if instruction else None,
    }
    return {key: shorten(_text(value)) for key, value in shown.items() if value is not None}


def candidate_measures(line: CandidateLine) -> tuple[Measure, ...]:
    """Return a candidate's metrics: the losses of every epoch and seed, and each figure that its ledger line has."""
    losses = [
        Measure(key=key, value=value, step=epoch)
        for key, values in (("train_loss", line.train_losses), ("validation_loss", line.validation_losses))
        for epoch, value in enumerate(values or (), 1)
    ]
    losses += [Measure(key="seed_loss", value=one.validation_losses[-1], step=one.seed) for one in line.seeds]
    inserted = None if line.status is None else line.inserted
    return (*losses, *_measures({**_figures(line, _CANDIDATE_METRICS), "inserted": inserted}, 0))


def generation_measures(line: GenerationLine) -> tuple[Measure, ...]:
    """Return a generation's metrics; a figure that it does not have (no candidate was trained) is left out."""
    return _measures(_figures(line, _GENERATION_METRICS), line.generation)


def reference_measures(baseline: float | None, trivial: float | None, step: int) -> tuple[Measure, ...]:
    """Return the losses that the best one stands beside: the baseline's, and the trivial one of `search.chance`."""
    return _measures({"baseline": baseline, "trivial": trivial}, step)


def _figures(line: CandidateLine | GenerationLine, names: Sequence[str]) -> dict[str, float | None]:
    return {name: getattr(line, name) for name in names}


def _measures(figures: Mapping[str, float | None], step: int) -> tuple[Measure, ...]:
    return tuple(Measure(key=key, value=float(value), step=step) for key, value in figures.items() if value is not None)


def cost_measures(spent: Spending, step: int) -> tuple[Measure, ...]:
    """Return the metrics of what answers cost: tokens and US dollars, each of the answers of which it is known."""
    if not spent.answers:
        return ()
    usd = spent.usd if spent.answers > spent.unpriced else None
    known = spent.answers > spent.uncounted
    tokens = {"input_tokens": spent.input_tokens, "output_tokens": spent.output_tokens} if known else {}
    return _measures({"answers": spent.answers, **tokens, "usd": usd}, step)


def shorten(text: str) -> str:
    """Cut a text to `LONGEST_PARAM` characters, of which the last is then an ellipsis."""
    return text if len(text) <= LONGEST_PARAM else text[: LONGEST_PARAM - 1] + "…"


def note(summary: str) -> str:
    """Return a run's summary as its description: whole lines, as many as MLflow takes."""
    if len(summary) <= _LONGEST_NOTE:
        return summary
    more = "\n\n… (the rest is in summary.md, among the artifacts)"
    return summary[: _LONGEST_NOTE - len(more)].rpartition("\n")[0] + more


def shown_address(uri: str) -> str:
    """Return a tracking URI, or the name of the environment variable that holds it."""
    return uri or f"${URI_VARIABLE}"


def quoted_address(uri: str) -> str:
    """Return a tracking URI, or the variable that holds it, as a word of a command."""
    return shlex.quote(uri) if uri else f'"${URI_VARIABLE}"'


def viewing(uri: str, mlflow: str) -> str:
    """Return how to look at a store: a server's own page, or a command that serves one.

    An empty URI is the one in MLFLOW_TRACKING_URI; `mlflow` is how that command is spelt here.
    """
    is_page = uri.startswith(("http://", "https://"))
    return uri if is_page else f"{mlflow} ui --backend-store-uri {quoted_address(uri)}"


def _text(value: Json) -> str:
    return str(value) if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Totals:
    """Sums over the generations so far."""

    #: Best fitness of the first generation in which anything was trained.
    first: float | None = None
    #: Trained candidates, with those after a repair.
    trained: int = 0
    #: Part of the slots whose first answer was trained, in [0, 1], for each generation from 1 on.
    trainable: tuple[float, ...] = ()
    spent: Spending = field(default_factory=Spending)

    def after(self, line: GenerationLine, spent: Spending) -> Self:
        """Return the totals after one more generation, whose answers cost so much."""
        shares = (line.trained / line.candidates,) if line.generation and line.candidates else ()
        return type(self)(
            first=line.best if self.first is None else self.first,
            trained=self.trained + line.trained + (line.repaired or 0),
            trainable=(*self.trainable, *shares),
            spent=total((self.spent, spent)),
        )


def total_measures(totals: Totals, line: GenerationLine) -> tuple[Measure, ...]:
    """Return the metrics of what adds up over a search.

    Returns:
        `improvement` on the first best, a part of it in (-inf, 1]; `trainable_rate`, the mean over generations 1 to
        this one, in [0, 1]; `trained_candidates`; and the costs so far as `total_answers` and so on. What does not
        apply yet is left out.
    """
    figures: dict[str, float | None] = {"trained_candidates": totals.trained}
    if totals.first is not None and line.best is not None:
        figures["improvement"] = (totals.first - line.best) / totals.first if totals.first else 0.0
    if totals.trainable:
        figures["trainable_rate"] = sum(totals.trainable) / len(totals.trainable)
    costs = {f"total_{measure.key}": measure.value for measure in cost_measures(totals.spent, line.generation)}
    return _measures({**figures, **costs}, line.generation)
