"""Finished sweeps made by hand: a few runs an arm, whose candidates a test names."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from hand_runs import altered, closed, configured, run, trained

from analysis.sweeps.ablation import Ablation, compare_arms, curves_frame, jobs_frame
from analysis.sweeps.common_archive import common_archive
from tacevo.costs import Spending
from tacevo.evolution.lines import CandidateLine
from tacevo.results.run import RecordedRun
from tacevo.results.sweep import FinishedJob, RecordedSweep
from tacevo.storage.plan_file import Measure, SeedPlan
from tacevo.storage.sweep_directory import Job

VERSIONS: Any = {name: "1.0" for name in ("python", "tacevo", "torch", "numpy", "scipy", "scikit-learn", "pillow")}

#: The best losses of two arms, seed by seed.
NONE = (0.40, 0.41, 0.42, 0.43, 0.44)
WORSE = (0.50, 0.51, 0.52, 0.53, 0.54)


def finished(arm: str, seed: int, one: RecordedRun, *, settings: Mapping[str, Any] | None = None) -> FinishedJob:
    """Make a finished job of a run; `settings` holds what is not as in every run by hand, by group and key."""
    name = f"{arm}-seed{seed}"
    config = configured(seed=seed, **(settings or {}))
    return FinishedJob(
        job=Job(name=name, arm=arm, seed=seed, overrides=(), config=name),
        run=altered(one, path=Path("sweep") / name, config=config, versions=one.record.versions or VERSIONS),
    )


def run_of(candidates: Sequence[CandidateLine], spent: Mapping[str, Spending] | None = None) -> RecordedRun:
    """Make a run of trained candidates, in their order; the generations follow from them."""
    lines = []
    for generation in range(candidates[-1].generation + 1):
        losses = [one.fitness for one in candidates if one.fitness is not None and one.generation <= generation]
        own = sum(one.generation == generation for one in candidates)
        lines.append(closed(generation, min(losses), candidates=own, trained=own))
    return run(candidates, lines, spent=spent)


def run_to(*bests: float, descriptors: Sequence[tuple[float, float]] = ()) -> RecordedRun:
    """Make a run of one candidate a generation, with these losses, at these places or all at one."""
    places = list(descriptors) or [(0.5, 0.5)] * len(bests)
    pairs = enumerate(zip(bests, places, strict=True))
    return run_of([trained(number, 0, loss, descriptors=place) for number, (loss, place) in pairs])


def sweep_of(jobs: Sequence[FinishedJob]) -> RecordedSweep:
    """Make a sweep whose jobs are all finished."""
    return RecordedSweep(path=Path("sweep"), finished=tuple(jobs), missing=())


def jobs_of(arm: str, bests: Sequence[float]) -> list[FinishedJob]:
    """Make an arm's jobs, one a seed, each of two trained candidates with a price; the baseline has 0.8."""
    spent = Spending(answers=1, input_tokens=10, output_tokens=5, usd=0.25)
    return [
        finished(
            arm, seed, run_of([trained(0, 0, 0.8), trained(1, 0, best, descriptors=(0.1, 0.9))], {"g01s00": spent})
        )
        for seed, best in enumerate(bests)
    ]


def curves_of(jobs: Sequence[FinishedJob]) -> pd.DataFrame:
    """Measure jobs by generation in two niches, left and right."""
    runs = [job.run for job in jobs]
    return curves_frame(jobs, common_archive(runs, runs[0], np.array([[0.25, 0.5], [0.75, 0.5]])))


def compared(*jobs: FinishedJob) -> tuple[RecordedSweep, Ablation]:
    """Compare jobs, measured in two niches."""
    return sweep_of(jobs), compare_arms(jobs_frame(jobs, curves_of(jobs)))


#: What a sweep may follow.
PLAN = SeedPlan(
    kind="sweep",
    task="force",
    metric=Measure.mse,
    effect=0.1,
    alpha=0.05,
    power=0.8,
    comparisons=1,
    seeds=12,
    retraining=3,
    epochs=50,
    spread=0.1,
    chance=0.81,
    trainings=108,
    hours=None,
    pilots=("a" * 64,),
)
