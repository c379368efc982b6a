"""What MLflow shows of a run: pure functions from its records to params, metrics, tags and nested runs."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

from pydantic import AliasPath, Field

from tacevo.choices import PAPER_AXES, Carrier
from tacevo.costs import Spending, total
from tacevo.environment import Code
from tacevo.errors import RunError
from tacevo.evolution.lines import CandidateLine, GenerationLine
from tacevo.parts.facts import source_facts
from tacevo.records import STRICT, Instruction, Json, Operator
from tacevo.storage.canonical import leaves
from tacevo.storage.run_directory import RunRecord
from tacevo.typed import convert

#: The longest param, in characters: older MLflow servers refuse more.
LONGEST_PARAM = 500

#: The longest description of a run, in characters, for the same reason.
_LONGEST_NOTE = 5_000

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

#: One of them that every generation has; by its steps the generations in a store are known.
EVERY_GENERATION = "candidates"

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


#: The tags that name a nested run: the id of a candidate, the directory of a study.
CANDIDATE_TAG, STUDY_TAG = "tacevo.candidate", "tacevo.study"


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """A candidate or a study as MLflow shows it: a run that is nested in that of its search."""

    #: `CANDIDATE_TAG` or `STUDY_TAG`.
    tag: str
    name: str
    #: The hash of the line that it comes from: a candidate's in the ledger, the last one of a study's scores.
    line: str
    params: Mapping[str, str]
    points: Sequence[Point]
    tags: Mapping[str, str] = field(default_factory=dict)
    #: Artifacts by name.
    files: Mapping[str, str] = field(default_factory=dict)
    failed: bool = False


def shown_candidate(
    line: CandidateLine, seal: str, instructions: Sequence[Instruction], spent: Spending, source: str | None
) -> Shown:
    """Show a candidate of the ledger; `seal` is the hash of its line, `source` the text that it was admitted with."""
    return Shown(
        tag=CANDIDATE_TAG,
        name=line.id,
        line=seal,
        params=candidate_params(line, instructions),
        points=(*candidate_measures(line), *cost_measures(spent, 0)),
        files={} if source is None else {f"{line.id}.py": source},
        failed=line.stage is not None,
    )


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
        "carrier": None if line.carrier is Carrier.parameter else line.carrier,
        "level": line.level,
        "effort": line.effort,
        "model": line.model,
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


#: The longest digest that MLflow keeps, in characters.
_DIGEST = 36

#: What makes simulated images; without a commit, because the runs of several share one data set in MLflow.
_SIMULATION = {"mlflow.source.name": "tacevo data simulate", "mlflow.source.type": "LOCAL"}

#: The mirror reads a part of the configuration.
_PART = {**STRICT, "extra": "ignore"}


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSettings:
    """The settings of a run that the mirror acts on, out of its whole configuration."""

    __pydantic_config__ = _PART

    source: Annotated[str, Field(validation_alias=AliasPath("data", "source"))]
    root: Annotated[str | None, Field(validation_alias=AliasPath("data", "root"))]
    uri: Annotated[str, Field(validation_alias=AliasPath("tracking", "uri"))]
    experiment: Annotated[str, Field(validation_alias=AliasPath("tracking", "experiment"))]


def read_settings(run: RunRecord, place: str = "run.json") -> RunSettings:
    """Read the settings that the mirror acts on.

    Raises:
        RunError: the configuration lacks one.
    """
    return convert(RunSettings, run.config, place=f"{place}, config", error=RunError, remedy="restore the file")


def source_tags(code: Code | None) -> dict[str, str]:
    """Return the tags by which MLflow shows the code of a run: the command, and the commit where one is recorded."""
    tags = {"mlflow.source.name": "tacevo search", "mlflow.source.type": "LOCAL"}
    if code is not None:
        tags |= {"mlflow.source.git.commit": code.commit, "mlflow.source.git.dirty": json.dumps(code.dirty)}
    return tags


def shown_config(run: RunRecord) -> dict[str, Json]:
    """Return a run's configuration as MLflow shows it: its model is called by the label, if it has one.

    Of several models, the names of all stand for it.
    """
    config, llm = dict(run.config), run.config.get("llm")
    if isinstance(llm, Mapping) and (several := llm.get("models")):
        config["llm"] = {**llm, "model": ", ".join(str(name) for name, _ in several)}  # type: ignore[union-attr,misc]
    elif isinstance(llm, Mapping) and llm.get("label"):
        config["llm"] = {**llm, "model": llm["label"]}
    return config


def search_tags(run: RunRecord) -> dict[str, str]:
    """Return the tags by which searches are found: task, and what answered, unless the networks were given."""
    llm = shown_config(run).get("llm", {})
    asked = llm if isinstance(llm, Mapping) and not run.is_of_given else {}
    answered = {f"tacevo.{key}": str(asked[key]) for key in ("provider", "model") if key in asked}
    return {"tacevo.task": run.task.name, **answered}


def data_set(run: RunRecord) -> dict[str, str]:
    """Name the data set of a run in the fields of MLflow's entity: images made here come from code, others from a root.

    The digest is the beginning of the fingerprint, as much as MLflow keeps.
    """
    origin = read_settings(run)
    is_simulated = source_facts(origin.source).is_made
    return {
        "name": f"{run.task.name} ({origin.source})",
        "digest": run.data.fingerprint[:_DIGEST],
        "source_type": "code" if is_simulated else "local",
        "source": json.dumps({"tags": _SIMULATION} if is_simulated else {"uri": origin.root or ""}),
    }
