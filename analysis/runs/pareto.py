"""The price of accuracy: the trained candidates of a run beside their costs, and its hypervolume by generation.

A fitness is a validation loss, so it is lower-is-better, as a cost is.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from analysis.statistics.pareto import front, hypervolume
from tacevo.results.run import RecordedRun
from tacevo.rounding import rounded

#: The columns of a frame of trained candidates, whose index is `id`, and the type of each: the fitness, what it is in
#: words, and how many trainings it is the median of; the costs.
PARETO = {"fitness": "float64", "estimate": "str", "draws": "Int64", "parameters": "Int64", "flops": "Int64"}

#: The value of `estimate` where a study or a noise run gave the fitness.
REESTIMATED = "re-estimated"

#: The value of `estimate` elsewhere: the search trained a candidate once.
ONE_DRAW = "one draw"


def reference_point(run: RecordedRun) -> tuple[float, int] | None:
    """Return the reference point of a run's hypervolume, in loss and FLOPs; None where the baseline has no fitness.

    It is the baseline's fitness, and the most FLOPs of any trained candidate: a network that is not better than the
    baseline counts for nothing.
    """
    baseline = run.baseline.fitness if run.trained else None
    return None if not baseline else (baseline, max(line.flops or 0 for line in run.trained))


def hypervolumes(run: RecordedRun) -> list[float | None]:
    """Return the hypervolume in loss and FLOPs of all that had been trained after each generation, in [0, 1].

    It never falls. None without a reference point.
    """
    reference = reference_point(run)
    if reference is None:
        return [None] * len(run.generations)
    points = [(line.generation, run.fitness[line.id], line.flops or 0) for line in run.trained]
    return [
        hypervolume([point for born, *point in points if born <= line.generation], reference)
        for line in run.generations
    ]


def with_hypervolumes(run: RecordedRun, generations: pd.DataFrame) -> pd.DataFrame:
    """Add the column `hypervolume` (float64) to a frame with a row for each generation of a run."""
    return generations.assign(hypervolume=hypervolumes(run)).astype({"hypervolume": "float64"})


def beside_costs(run: RecordedRun, again: Mapping[str, Sequence[float]]) -> pd.DataFrame:
    """Return a row for each trained candidate (`PARETO`), in the order of the ledger.

    `again` are losses of a source, by its SHA-256, under seeds by which the search did not choose it. Their median is
    the fitness; any other is the recorded one.
    """
    rows = {}
    for line in run.trained:
        values = again.get(str(line.source), ())
        fitness = rounded(float(np.median(values))) if values else line.fitness
        words = REESTIMATED if values else ONE_DRAW
        rows[line.id] = (fitness, words, len(values) or 1, line.parameters, line.flops)
    index = pd.Index(list(rows), name="id", dtype="str")
    return pd.DataFrame(list(rows.values()), index=index, columns=list(PARETO)).astype(PARETO)


def on_front(candidates: pd.DataFrame, objectives: Sequence[str]) -> pd.DataFrame:
    """Return the candidates on the front of some columns, lowest first objective first.

    One without a value in one of them is left out.
    """
    whole = candidates.dropna(subset=list(objectives))
    return whole.iloc[front(whole[list(objectives)].to_numpy(np.float64))]
