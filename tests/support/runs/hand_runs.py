"""Finished runs made by hand, for tests of the analysis: few slots, where a test names only what it is about."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ledger_lines import candidate, ended

from tacevo.config.compose import compose
from tacevo.config.plain import to_plain
from tacevo.config.schema import RunConfig
from tacevo.costs import Spending
from tacevo.errors import ConfigError
from tacevo.evolution.archive import AddStatus, Bounds
from tacevo.evolution.files import EliteEntry, TrialEntry
from tacevo.evolution.lines import CandidateLine, GenerationLine, RepairedAnswer
from tacevo.records import DataFacts, Kind, Operator, Reason, Stage
from tacevo.results.run import RecordedRun
from tacevo.rules import FIRST
from tacevo.typed import convert

FACTS = DataFacts(
    fingerprint="ab", kind=Kind.regression, counts=(8, 1, 1), in_channels=3, image_size=32, outputs=1, names=("F",)
)

_SMALL = ["llm=grammar", "search.candidates=2", "search.initial=1", "training.epochs=1"]

_CONFIG: Any = to_plain(compose([*_SMALL, "archive.niches=4", "archive.samples=100", "archive.eff_ratio_scale=linear"]))


def configured(**groups: Any) -> RunConfig:
    """Return the settings of a run by hand, with other values of single keys: `configured(archive={"niches": 9})`."""
    changed = {name: {**_CONFIG[name], **value} if isinstance(value, dict) else value for name, value in groups.items()}
    return convert(RunConfig, {**_CONFIG, **changed}, place="a run by hand", error=ConfigError)


def bounds_of(*axes: tuple[float, float]) -> Bounds:
    """Make bounds from the (low, high) of each axis."""
    low, high = zip(*axes, strict=True)
    return Bounds(low=low, high=high)


def trained(
    generation: int,
    slot: int,
    fitness: float = 0.5,
    *,
    parents: Sequence[str] = ("g00s00",),
    prompt: int | None = 0,
    temperature: float = 0.6,
    source: str | None = None,
    status: AddStatus = AddStatus.new,
    descriptors: tuple[float, float] = (0.5, 0.5),
    repairs: Sequence[tuple[Stage, Reason]] = (),
    dropped: tuple[str, ...] = (),
) -> CandidateLine:
    """Make a mutation that trained; its source is its own unless one is given, and without a prompt it is a crossover.

    The first slot of generation 0 is the baseline.
    """
    name = f"g{generation:02}s{slot:02}"
    baseline = (generation, slot) == (0, 0)
    bred = Operator.mutation if prompt is not None else Operator.crossover
    return candidate(
        name,
        operator=Operator.baseline if baseline else bred,
        parents=() if baseline else tuple(parents),
        prompt=None if baseline else prompt,
        temperature=None if baseline else temperature,
        dropped=dropped,
        repairs=tuple(RepairedAnswer(answer="", stage=stage, reason=reason) for stage, reason in repairs),
        source=source or name,
        evaluation=f"evaluation of {source or name}",
        parameters=10,
        flops=10,
        arch_div=descriptors[0],
        eff_ratio=descriptors[1],
        fitness=fitness,
        validation_losses=(fitness,),
        niche=0,
        status=status,
    )


def rejected(
    generation: int, slot: int, stage: Stage = Stage.probe, reason: Reason = Reason.forward_failed, *, prompt: int = 0
) -> CandidateLine:
    """Make a mutation that the gate rejected."""
    asked: dict[str, Any] = {"operator": Operator.mutation, "parents": ("g00s00",), "temperature": 0.6}
    return candidate(f"g{generation:02}s{slot:02}", prompt=prompt, stage=stage, reason=reason, **asked)


def elite(name: str, *, niche: int, fitness: float) -> EliteEntry:
    """Make an elite of the network archive."""
    return EliteEntry(niche=niche, id=name, fitness=fitness, descriptors=(0.5, 0.5))


def closed(
    generation: int,
    best: float | None = 0.5,
    *,
    candidates: int = 1,
    trained: int = 1,
    coverage: float = 0.25,
    temperature: float = 0.6,
) -> GenerationLine:
    """Make the line that ends a generation."""
    return ended(
        generation,
        temperature=temperature,
        next_temperature=temperature,
        candidates=candidates,
        trained=trained,
        best=best,
        generation_best=best,
        generation_median=best,
        coverage=coverage,
        qd_score=1.0,
        prompt_coverage=0.0,
    )


def run(
    candidates: Sequence[CandidateLine],
    generations: Sequence[GenerationLine],
    *,
    elites: Sequence[EliteEntry] = (),
    instructions: Sequence[str] = ("refine", "widen"),
    archive: Mapping[str, Any] | None = None,
    bounds: tuple[tuple[float, float], ...] | None = ((0.0, 1.0), (0.0, 1.0)),
    spent: Mapping[str, Spending] | None = None,
) -> RecordedRun:
    """Make a run; `archive` holds settings of its archive that are not the default ones."""
    return RecordedRun(
        path=Path("runs/hand"),
        name="hand",
        digest="0" * 64,
        config=configured(archive=archive or {}),
        facts=FACTS,
        centroids="",
        instructions=tuple(instructions),
        candidates=tuple(candidates),
        generations=tuple(generations),
        elites=tuple(elites),
        bounds=None if bounds is None else bounds_of(*bounds),
        prompt_trials=(),
        rules=FIRST,
        versions={},
        spent=spent or {},
        cpu_seconds={},
        trivial=None,
        model="a model",
    )


def prompt_trial(*, niche: int, prompt: int, temperature: float, inserted: bool, curiosity: float) -> TrialEntry:
    """Return a trial of prompts.json; what tables and figures do not read is empty."""
    return TrialEntry(
        niche=niche,
        centroid=(),
        id="",
        instruction="",
        prompt=prompt,
        temperature=temperature,
        inserted=inserted,
        curiosity=curiosity,
    )
