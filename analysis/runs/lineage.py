"""The ancestors of a network, step by step, back to the baseline."""

from collections.abc import Mapping

import pandas as pd

from tacevo.errors import RunError
from tacevo.evolution.lines import CandidateLine
from tacevo.results.run import RecordedRun

#: The columns of a lineage, whose index is `id`, and the type of each: parents are a tuple of ids; the instruction is
#: missing of the baseline and a crossover; the fitness is missing where a training failed; gain is how much less loss a
#: network has than the better of its parents, missing where one is unknown.
LINEAGE = {"generation": "int64", "operator": "str", "instruction": "str", "parents": "object"}
LINEAGE |= {"fitness": "float64", "gain": "float64"}


def ancestors(run: RecordedRun, name: str) -> tuple[CandidateLine, ...]:
    """Return a candidate's ancestors in the order of the search, each once, and itself last.

    Raises:
        RunError: the run has no such candidate.
    """
    known = {candidate.id: candidate for candidate in run.candidates}
    if name not in known:
        raise RunError(repr(name), place=str(run.path), expected="the id of a candidate, e.g. g02s03")
    lines: dict[str, CandidateLine] = {}
    waiting = [name]
    while waiting:
        candidate = known[waiting.pop()]
        if candidate.id not in lines:
            lines[candidate.id] = candidate
            waiting += candidate.parents
    return tuple(sorted(lines.values(), key=lambda candidate: (candidate.generation, candidate.slot)))


def lineage(run: RecordedRun, name: str) -> pd.DataFrame:
    """Return a candidate's ancestors with what was asked for and what it brought; raises as `ancestors` does.

    A row each, in the order of the search, and the candidate itself last (`LINEAGE`).
    """
    ancestry, fitness = ancestors(run, name), run.fitness
    rows = [
        {
            "generation": candidate.generation,
            "operator": candidate.operator.value,
            "instruction": None if candidate.prompt is None else run.instructions[candidate.prompt],
            "parents": candidate.parents,
            "fitness": fitness.get(candidate.id),
            "gain": _gain(candidate, fitness),
        }
        for candidate in ancestry
    ]
    return pd.DataFrame(rows, index=pd.Index([one.id for one in ancestry], name="id")).astype(LINEAGE)


def _gain(candidate: CandidateLine, fitness: Mapping[str, float]) -> float | None:
    parents = [fitness[parent] for parent in candidate.parents if parent in fitness]
    return min(parents) - fitness[candidate.id] if parents and candidate.id in fitness else None
