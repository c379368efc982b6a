"""What MLflow shows of a run: pure functions from its configuration and ledger lines to params and metrics."""

import json
import shlex
from collections.abc import Mapping, Sequence

from tacevo.choices import PAPER_AXES
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
    "skipped",
    "temperature",
)

_CANDIDATE_METRICS = (
    "fitness",
    *PAPER_AXES,
    "entropy",
    "density",
    "variation",
    "flops",
    "parameters",
    "niche",
    "curiosity",
)


#: One value of a metric: its name, the value, and the step, which is the generation of a search's metrics, the epoch
#: of a loss, and 0 of a candidate's other metrics.
Point = tuple[str, float, int]


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


def candidate_measures(line: CandidateLine) -> tuple[Point, ...]:
    """Return a candidate's metrics: the losses of every epoch, and each figure that its ledger line has."""
    losses = [
        (key, value, epoch)
        for key, values in (("train_loss", line.train_losses), ("validation_loss", line.validation_losses))
        for epoch, value in enumerate(values or (), 1)
    ]
    inserted = None if line.status is None else line.inserted
    return (*losses, *_measures({**_figures(line, _CANDIDATE_METRICS), "inserted": inserted}, 0))


def generation_measures(
    line: GenerationLine, *, baseline: float | None = None, trivial: float | None = None
) -> tuple[Point, ...]:
    """Return a generation's metrics; a figure that it does not have (no candidate was trained) is left out.

    Beside the best loss stand the baseline's and the trivial one (`tacevo.evolution.chance`).
    """
    return _measures({**_figures(line, _GENERATION_METRICS), "baseline": baseline, "trivial": trivial}, line.generation)


def _figures(line: CandidateLine | GenerationLine, names: Sequence[str]) -> dict[str, float | None]:
    return {name: getattr(line, name) for name in names}


def _measures(figures: Mapping[str, float | None], step: int) -> tuple[Point, ...]:
    return tuple((key, float(value), step) for key, value in figures.items() if value is not None)


def cost_measures(spent: Spending, step: int) -> tuple[Point, ...]:
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


def note(text: str, file: str) -> str:
    """Return a text, which an artifact holds too, as a description: as many whole lines as MLflow takes."""
    if len(text) <= _LONGEST_NOTE:
        return text
    more = f"\n\n… (the rest is in {file}, among the artifacts)"
    return text[: _LONGEST_NOTE - len(more)].rpartition("\n")[0] + more


def shown_address(uri: str) -> str:
    """Return a tracking URI, or the name of the environment variable that holds it."""
    return uri or f"${URI_VARIABLE}"


def viewing(uri: str, mlflow: str) -> str:
    """Return how to look at a store: a server's own page, or a command that serves one.

    An empty URI is the one in MLFLOW_TRACKING_URI; `mlflow` is how that command is spelt here.
    """
    if uri.startswith(("http://", "https://")):
        return uri
    address = shlex.quote(uri) if uri else f'"${URI_VARIABLE}"'
    return f"{mlflow} ui --backend-store-uri {address}"


def _text(value: Json) -> str:
    return str(value) if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


class Totals:
    """What adds up over the generations of a search."""

    def __init__(self) -> None:
        self._first: float | None = None
        self._trained = 0
        self._shares: list[float] = []
        self._spent = Spending()

    def after(self, line: GenerationLine, spent: Spending) -> tuple[Point, ...]:
        """Add a generation, whose answers cost so much; return the metrics of all so far.

        Returns:
            `improvement` on the best of the first generation in which anything was trained, a part of it in (-inf, 1];
            `trainable_rate`, the mean of `GenerationLine.trainable` over generations 1 to this one, in [0, 1];
            `trained_candidates`, with those after a repair; and the costs as `total_answers` and so on. What does not
            apply yet is left out.
        """
        self._first = line.best if self._first is None else self._first
        self._trained += line.trained + (line.repaired or 0)
        self._shares += [line.trainable] if line.generation and line.candidates else []
        self._spent = total((self._spent, spent))
        figures: dict[str, float | None] = {"trained_candidates": self._trained}
        if self._first is not None and line.best is not None:
            figures["improvement"] = (self._first - line.best) / self._first if self._first else 0.0
        if self._shares:
            figures["trainable_rate"] = sum(self._shares) / len(self._shares)
        costs = {f"total_{key}": value for key, value, _ in cost_measures(self._spent, line.generation)}
        return _measures({**figures, **costs}, line.generation)
