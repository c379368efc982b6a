"""A part: parents by a lower bound of what a model of the search's own trainings expects of each network.

    tacevo search experiment=table proposals.parents=benchmarks/bounded_parents.py:LowerBound

`python -m benchmarks.bounds` says what came of it.
"""

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tacevo.parts import Candidate, Parents, Population

C = TypeVar("C", bound=Candidate)

#: Until so many networks are known there is no model, and the elites are the pool.
LEAST = 10

#: The weight of the squared coefficients, of standardised features.
ALPHA = 1.0

_CALL = re.compile(r"\b(?:nn|F|torch)\.(\w+)\(")


@dataclass(frozen=True)
class LowerBound(Parents):
    """Of all networks that trained, those of the lowest bound: the expected log fitness less its standard deviations.

    The model is a Bayesian ridge regression of the log fitness on what the text of a network shows: how often it names
    each layer and function, its parameters and its FLOPs, all as log(1 + x). One seed trains a network once, so what
    is expected of it is less noisy than its own fitness; where the model knows little, the bound is lower, and the
    search looks there.
    """

    #: The number of networks that may be parents.
    count: int = 5
    #: The standard deviations of the estimate that are taken off; 0 is the estimate alone.
    deviations: float = 1.0

    def __post_init__(self) -> None:
        """Refuse a pool of which no two parents can be drawn."""
        if self.count < 2:
            raise ValueError(f"count: expected at least 2, which can be crossed; got {self.count}")

    def pool(self, population: Population) -> Sequence[Candidate]:
        """Return the networks of the lowest bounds, of equal ones the first; of each text one."""
        networks = [*{one.source: one for one in reversed([*population.candidates.values()])}.values()][::-1]
        if len(networks) < LEAST:
            return population.elites
        expected, deviations = estimates([seen(one) for one in networks], [one.fitness for one in networks])
        order = np.argsort(expected - self.deviations * deviations, kind="stable")
        return [networks[row] for row in order[: self.count]]

    def draw(self, pool: Sequence[C], number: int, rng: np.random.Generator) -> Sequence[C]:
        """Draw so many different ones, all alike."""
        return [pool[row] for row in rng.permutation(len(pool))[:number]]


def seen(one: Candidate) -> Mapping[str, float]:
    """Return what the model sees of a network."""
    counts = Counter(_CALL.findall(one.source)) | Counter(parameters=one.parameters, flops=one.flops)
    return {name: math.log1p(count) for name, count in counts.items()}


def estimates(
    features: Sequence[Mapping[str, float]], fitness: Sequence[float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit the model; return of each network the expected log fitness, and the standard deviation of that estimate.

    Args:
        features: of each network; what one lacks is 0.
        fitness: of each, above 0, or infinite where a training failed: it counts as the worst.
    """
    names = sorted({name for one in features for name in one})
    design = np.array([[one.get(name, 0.0) for name in names] for one in features])
    design = design[:, design.max(axis=0) > design.min(axis=0)]
    design = (design - design.mean(axis=0)) / design.std(axis=0)
    logs = np.log(np.maximum(fitness, 1e-9))
    logs[~np.isfinite(logs)] = logs[np.isfinite(logs)].max(initial=0.0)
    left = logs - logs.mean()
    inverse = np.linalg.inv(design.T @ design + ALPHA * np.eye(design.shape[1]))
    hat = design @ inverse @ design.T
    expected = hat @ left
    freedom = max(len(logs) - 1 - float(np.trace(hat)), 1.0)
    noise = float(((left - expected) ** 2).sum()) / freedom
    return logs.mean() + expected, np.sqrt(noise * (np.diag(hat) + 1 / len(logs)))
