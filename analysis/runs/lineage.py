"""Where a network comes from: its ancestors, step by step, back to the baseline."""

from collections.abc import Mapping
from dataclasses import dataclass

from analysis.runs.run import Run
from tacevo.errors import RunError
from tacevo.evolution.lines import CandidateLine


@dataclass(frozen=True, slots=True, kw_only=True)
class Ancestor:
    """One network of a lineage."""

    #: With its id, generation, operator, prompt and parents.
    candidate: CandidateLine
    #: What the search knew of it at its end; None where a training of it failed.
    fitness: float | None
    #: Id of its instruction; None for the baseline and a crossover.
    instruction: str | None
    #: How much less loss it has than the better of its parents; negative where it has more, None where one is unknown.
    gain: float | None


def ancestors(run: Run, name: str) -> tuple[CandidateLine, ...]:
    """Return a candidate's ancestors in the order of the search, each once, and itself last.

    Raises:
        RunError: the run has no such candidate.
    """
    known = {candidate.id: candidate for candidate in run.candidates}
    if name not in known:
        raise RunError(repr(name), place=str(run.path), expected="the id of a candidate, e.g. g02s03")
    found: dict[str, CandidateLine] = {}
    waiting = [name]
    while waiting:
        candidate = known[waiting.pop()]
        if candidate.id not in found:
            found[candidate.id] = candidate
            waiting += candidate.parents
    return tuple(sorted(found.values(), key=lambda candidate: (candidate.generation, candidate.slot)))


def lineage(run: Run, name: str) -> tuple[Ancestor, ...]:
    """Return a candidate's ancestors with what was asked for and what it brought; raises as `ancestors` does."""
    found = ancestors(run, name)
    fitness = run.fitness
    return tuple(
        Ancestor(
            candidate=candidate,
            fitness=fitness.get(candidate.id),
            instruction=None if candidate.prompt is None else run.instructions[candidate.prompt],
            gain=_gain(candidate, fitness),
        )
        for candidate in found
    )


def _gain(candidate: CandidateLine, fitness: Mapping[str, float]) -> float | None:
    parents = [fitness[parent] for parent in candidate.parents if parent in fitness]
    return min(parents) - fitness[candidate.id] if parents and candidate.id in fitness else None
