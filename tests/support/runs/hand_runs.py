"""Finished runs made by hand, for tests of the analysis: few slots, where a test names only what it is about."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ledger_lines import candidate, ended, header, run_record

from tacevo.config.compose import compose
from tacevo.config.schema import RunConfig
from tacevo.costs import Spending
from tacevo.errors import ConfigError
from tacevo.evolution.archive import AddStatus, AxisBounds
from tacevo.evolution.lines import CandidateLine, GenerationLine, RepairedAnswer
from tacevo.evolution.run_files import EliteEntry, Line, TrialEntry
from tacevo.records import DataFacts, Instruction, Kind, Operator, Reason, Stage, to_json
from tacevo.results.run import RecordedRun
from tacevo.storage.ledger import Sealed
from tacevo.storage.run_directory import RunDirectory, RunRecord
from tacevo.typed import convert

FACTS = DataFacts(
    fingerprint="ab", kind=Kind.regression, counts=(8, 1, 1), in_channels=3, image_size=32, outputs=1, names=("F",)
)

_SMALL = ["llm=grammar", "search.candidates=2", "search.initial=1", "training.epochs=1"]

_CONFIG: Any = to_json(compose([*_SMALL, "archive.niches=4", "archive.samples=100", "archive.eff_ratio_scale=linear"]))


def configured(**groups: Any) -> RunConfig:
    """Return the settings of a run by hand, with other values of single keys: `configured(archive={"niches": 9})`."""
    changed = {name: {**_CONFIG[name], **value} if isinstance(value, dict) else value for name, value in groups.items()}
    return convert(RunConfig, {**_CONFIG, **changed}, place="a run by hand", error=ConfigError)


def bounds_of(*axes: tuple[float, float]) -> AxisBounds:
    """Make bounds from the (low, high) of each axis."""
    low, high = zip(*axes, strict=True)
    return AxisBounds(low=low, high=high)


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
    made = RecordedRun(
        directory=RunDirectory(Path("runs/hand")),
        record=run_record(data=FACTS),
        config=configured(archive=archive or {}),
        ledger=Sealed((header(data=FACTS, centroids=""), *candidates, *generations), ("0" * 64,)),
        elites=tuple(elites),
        prompt_trials=(),
    )
    bounded = None if bounds is None else bounds_of(*bounds)
    return altered(made, instructions=instructions, bounds=bounded, spent=spent or {}, cpu_seconds={})


def of_lines(
    *lines: Line,
    elites: Mapping[str, int] | None = None,
    config: RunConfig | None = None,
    record: RunRecord | None = None,
    spent: Mapping[str, Spending] | None = None,
) -> RecordedRun:
    """Make a run, finished or not, of the lines of its ledger; elites by their niches."""
    made = RecordedRun(
        directory=RunDirectory(Path("run")),
        record=record or run_record(),
        config=config or configured(),
        ledger=Sealed(lines, ("d" * 64,)),
        elites=tuple(elite(name, niche=niche, fitness=0.0) for name, niche in (elites or {}).items()),
    )
    made.__dict__["spent"] = spent or {}
    return made


def altered(run: RecordedRun, **changes: Any) -> RecordedRun:
    """Return a run with other values of what it has: of its fields, of its lines, of its header or of run.json."""
    taken = {name: changes.pop(name) for name in tuple(changes) if name in _ALTERED}
    lines = {name: taken.get(name, getattr(run, name)) for name in ("candidates", "generations")}
    if "bounds" in taken and lines["generations"]:
        lines["generations"] = (*lines["generations"][:-1], replace(lines["generations"][-1], bounds=taken["bounds"]))
    of_header = {_ALTERED[name]: taken[name] for name in ("facts", "centroids", "rules") if name in taken}
    of_record: dict[str, Any] = {name: taken[name] for name in ("versions", "trivial", "elsewhere") if name in taken}
    if "instructions" in taken:
        named = tuple(Instruction(id=name, text=name) for name in taken["instructions"])
        of_record["task"] = replace(run.record.task, instructions=named)
    path = run.path.with_name(taken["name"]) if "name" in taken else taken.get("path", run.path)
    every = (replace(run.header, **of_header), *itertools.chain(*lines.values()))
    made = replace(
        run,
        directory=RunDirectory(path),
        record=replace(run.record, **of_record),
        ledger=Sealed(every, (taken.get("digest", run.digest),)),
        **changes,
    )
    made.__dict__.update({name: taken.get(name, getattr(run, name)) for name in ("spent", "cpu_seconds")})
    return made


#: What `altered` takes beyond the fields, and where that stands if it has another name there.
_ALTERED = {
    **{name: name for name in ("candidates", "generations", "bounds", "rules", "instructions")},
    **{name: name for name in ("centroids", "versions", "trivial", "elsewhere", "name", "path", "digest", "spent")},
    "facts": "data",
    "cpu_seconds": "cpu_seconds",
}


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
