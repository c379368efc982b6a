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

    The model is a ridge regression of the log fitness on what the text of a network shows: how often it names each
    layer and function, its parameters and its FLOPs, all as log(1 + x). One seed trains a network once, so what is
    expected of it is less noisy than its own fitness. Where the model knows little, the bound is lower, and the search
    looks there.
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
        """Return the networks of the lowest bounds; of equal bounds, and of several exactly as fit, the first."""
        first: dict[float, Candidate] = {}
        for one in population.candidates.values():
            if math.isfinite(one.fitness):
                first.setdefault(one.fitness, one)  # two exactly as fit are one network that came again
        if len(first) < LEAST:
            return population.elites
        expected, deviations = estimates([seen(one) for one in first.values()], [*first])
        bounds = np.round(expected - self.deviations * deviations, 9)  # last bits decide nothing
        networks = [*first.values()]
        return [networks[row] for row in np.argsort(bounds, kind="stable")[: self.count]]

    def draw(self, pool: Sequence[C], number: int, rng: np.random.Generator) -> Sequence[C]:
        """Draw so many different ones, all alike: by the same random numbers as the rule `uniform`."""
        left = list(pool)
        return [left.pop(int(rng.integers(len(left)))) for _ in range(number)]


def seen(one: Candidate) -> Mapping[str, float]:
    """Return what the model sees of a network."""
    counts = {**Counter(_CALL.findall(one.source)), "parameters": one.parameters, "flops": one.flops}
    return {name: math.log1p(count) for name, count in counts.items()}


def estimates(
    features: Sequence[Mapping[str, float]], fitness: Sequence[float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit the model; return of each network the expected log fitness, and the standard deviation of that estimate.

    With standardised features X, log fitnesses y less their mean, and H = X (X'X + alpha I)^-1 X', the estimates are
    H y. Their variance is s^2 (diag H + 1 / n), that of the posterior if coefficients are normal around 0 with the
    variance s^2 / alpha and the mean is free; s^2 is the sum of squared residuals over n - 1 - tr H.

    Args:
        features: of each network; what one lacks is 0.
        fitness: of each; finite, and one below 1e-9 counts as this.
    """
    names = sorted({name for one in features for name in one})
    design = np.array([[one.get(name, 0.0) for name in names] for one in features])
    design = design[:, design.max(axis=0) > design.min(axis=0)]
    design = (design - design.mean(axis=0)) / design.std(axis=0)
    logs = np.log(np.maximum(fitness, 1e-9))
    left = logs - logs.mean()
    hat = design @ np.linalg.inv(design.T @ design + ALPHA * np.eye(design.shape[1])) @ design.T
    expected = hat @ left
    freedom = len(logs) - 1 - float(np.trace(hat))  # above 0, since alpha keeps the trace below the rank
    noise = float(((left - expected) ** 2).sum()) / freedom
    return logs.mean() + expected, np.sqrt(noise * (np.diag(hat) + 1 / len(logs)))
