"""Finished runs made by hand, for tests of the analysis: few slots, where a test names only what it is about."""

from collections.abc import Sequence
from pathlib import Path

from analysis.runs.run import Candidate, Elite, Generation, Measured, Run, Trained
from tacevo.costs import Spending
from tacevo.records import DataFacts, Json, Kind, Operator, Reason, Stage
from tacevo.rules import FIRST
from tacevo.search.lines import RulesLine

FACTS = DataFacts(
    fingerprint="ab", kind=Kind.regression, counts=(8, 1, 1), in_channels=3, image_size=32, outputs=1, names=("F",)
)

CONFIG: Json = {
    "task": {"name": "force"},
    "llm": {"provider": "grammar", "model": "grammar-1"},
    "data": {"source": "simulated"},
    "archive": {"niches": 4, "bounds": "adaptive", "eff_ratio_scale": "linear"},
    "prompts": {"policy": "uniform"},
    "temperature": {"rule": "paper", "start": 0.6, "step": 0.05},
}


def trained(
    generation: int,
    slot: int,
    fitness: float = 0.5,
    *,
    parents: Sequence[str] = ("g00s00",),
    prompt: int | None = 0,
    temperature: float = 0.6,
    source: str | None = None,
    status: str = "new",
    descriptors: tuple[float, float] = (0.5, 0.5),
    spent: Spending | None = None,
    sent_back: tuple[tuple[Stage, Reason], ...] = (),
    dropped: tuple[str, ...] = (),
) -> Candidate:
    """Make a mutation that trained; its source is its own unless one is given, and without a prompt it is a crossover.

    The first slot of generation 0 is the baseline.
    """
    name = f"g{generation:02}s{slot:02}"
    baseline = (generation, slot) == (0, 0)
    bred = Operator.mutation if prompt is not None else Operator.crossover
    return Candidate(
        id=name,
        generation=generation,
        slot=slot,
        operator=Operator.baseline if baseline else bred,
        parents=() if baseline else tuple(parents),
        prompt=None if baseline else prompt,
        temperature=None if baseline or "temperature" in dropped else temperature,
        source=source or name,
        evaluation=f"evaluation of {source or name}",
        stage=None,
        reason=None,
        measured=Measured(parameters=10, flops=10, arch_div=descriptors[0], eff_ratio=descriptors[1]),
        trained=Trained(fitness=fitness, validation_losses=(fitness,), niche=0, status=status),
        spent=spent,
        sent_back=sent_back,
        dropped=dropped,
    )


def turned_away(
    generation: int, slot: int, stage: Stage = Stage.probe, reason: Reason = Reason.forward_failed, *, prompt: int = 0
) -> Candidate:
    """Make a mutation that the gate turned away."""
    return Candidate(
        id=f"g{generation:02}s{slot:02}",
        generation=generation,
        slot=slot,
        operator=Operator.mutation,
        parents=("g00s00",),
        prompt=prompt,
        temperature=0.6,
        source=None,
        evaluation=None,
        stage=stage,
        reason=reason,
        measured=None,
        trained=None,
        spent=None,
    )


def closed(
    generation: int,
    best: float | None = 0.5,
    *,
    candidates: int = 1,
    trained: int = 1,
    coverage: float = 0.25,
    temperature: float = 0.6,
) -> Generation:
    """Make the line that ends a generation."""
    return Generation(
        generation=generation,
        temperature=temperature,
        candidates=candidates,
        trained=trained,
        best=best,
        generation_median=best,
        coverage=coverage,
        qd_score=1.0,
        prompt_coverage=0.0,
    )


def run(
    candidates: Sequence[Candidate],
    generations: Sequence[Generation],
    *,
    elites: Sequence[Elite] = (),
    instructions: Sequence[str] = ("refine", "widen"),
    archive: Json = None,
    bounds: tuple[tuple[float, float], ...] | None = ((0.0, 1.0), (0.0, 1.0)),
) -> Run:
    """Make a run; `archive` holds settings of its archive that differ from `CONFIG`."""
    return Run(
        path=Path("runs/hand"),
        name="hand",
        digest="0" * 64,
        config={**CONFIG, "archive": {**CONFIG["archive"], **(archive or {})}},
        facts=FACTS,
        centroids="",
        instructions=tuple(instructions),
        candidates=tuple(candidates),
        generations=tuple(generations),
        elites=tuple(elites),
        bounds=bounds,
        prompt_trials=(),
        eras=(RulesLine(generation=0, rules=FIRST),),
    )
