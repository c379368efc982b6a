"""Finished sweeps made by hand: a few runs an arm, whose candidates a test names."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from hand_runs import CONFIG, closed, run, trained

from analysis.runs.run import Candidate, Run
from analysis.sweeps.sweep import Finished, Sweep
from tacevo.records import Json
from tacevo.storage.sweep_directory import Job

VERSIONS: Json = {name: "1.0" for name in ("python", "tacevo", "torch", "numpy", "scipy", "scikit-learn", "pillow")}

#: Settings of a whole run that matter to a comparison.
SETTINGS: Json = {
    **CONFIG,
    "task": {"name": "force", "loss": "mse"},
    "archive": {**CONFIG["archive"], "samples": 100, "seed": 0},
    "search": {"candidates": 2, "initial": 1},
    "training": {"epochs": 1, "batch_size": 32, "learning_rate": 0.001, "device": "cpu", "seconds": 60.0},
    "numerics": {"kind": "portable"},
    "llm": {"provider": "grammar", "model": "grammar-1", "mode": "record"},
}
SETTINGS["training"]["memory_mib"] = 2048


def finished(arm: str, seed: int, one: Run, *, settings: Mapping[str, Json] | None = None) -> Finished:
    """Make a finished job of a run; `settings` holds whole groups that differ from `SETTINGS`."""
    name = f"{arm}-seed{seed}"
    config = {**SETTINGS, "seed": seed, **(settings or {})}
    return Finished(
        job=Job(name=name, arm=arm, seed=seed, overrides=(), config=name),
        run=replace(one, name=name, path=Path("sweep") / name, config=config),
        versions=VERSIONS,
    )


def run_of(candidates: Sequence[Candidate]) -> Run:
    """Make a run of trained candidates, in their order; the generations follow from them."""
    lines = []
    for generation in range(candidates[-1].generation + 1):
        losses = [one.trained.fitness for one in candidates if one.trained and one.generation <= generation]
        own = sum(one.generation == generation for one in candidates)
        lines.append(closed(generation, min(losses), candidates=own, trained=own))
    return run(candidates, lines)


def run_to(*bests: float, descriptors: Sequence[tuple[float, float]] = ()) -> Run:
    """Make a run of one candidate a generation, with these losses, at these places or all at one."""
    places = list(descriptors) or [(0.5, 0.5)] * len(bests)
    pairs = enumerate(zip(bests, places, strict=True))
    return run_of([trained(number, 0, loss, descriptors=place) for number, (loss, place) in pairs])


def sweep_of(jobs: Sequence[Finished]) -> Sweep:
    """Make a sweep whose jobs are all finished."""
    return Sweep(path=Path("sweep"), finished=tuple(jobs), missing=())
