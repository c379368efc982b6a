"""The choice of the candidates that a search does not train: a surrogate of its own trainings judges them worst; pure.

The surrogate is a ridge regression (Hoerl and Kennard 1970) of the logarithm of a network's fitness on what the probe
measured. It decides, so its bits must be equal everywhere: logarithms are rounded, sums are exact, and everything else
is plain arithmetic. No order of the networks matters.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from tacevo.evolution.proposals import Candidate
from tacevo.profile import Admitted, Profile
from tacevo.rounding import rounded

#: The number of networks that must be known before any is skipped.
LEAST = 20

#: The weight of the squared coefficients, of standardised features.
ALPHA = 1.0

#: A loss below it counts as this one, because 0 has no logarithm.
_LOWEST = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Surrogate:
    """A fitted regression: of each feature in which the networks differ its mean, deviation and coefficient."""

    terms: tuple[tuple[str, float, float, float], ...]
    #: The mean logarithm of the fitnesses.
    constant: float

    def predict(self, features: Mapping[str, float]) -> float:
        """Return the logarithm of the fitness that a network of these `features` is expected to have; finite."""
        parts = ((features.get(name, 0.0) - mean) / scale * weight for name, mean, scale, weight in self.terms)
        return math.fsum((self.constant, *parts))


@dataclass(frozen=True, slots=True, kw_only=True)
class SkipsWorst:
    """Skips what the surrogate judges worst."""

    #: The share of the networks that counts as worst, in (0, 1).
    part: float

    def features(self, profile: Profile) -> Mapping[str, float]:
        """Return what the surrogate sees of a network."""
        return features(profile)

    def skips(self, trained: Iterable[Candidate]) -> Callable[[Admitted], bool]:
        """Return what decides whether an admitted candidate is skipped, by the networks that were trained before.

        It is where its prediction is above all but `part` of those of the trained networks (their quantile,
        interpolated linearly). A network that was trained is not, and none is before `LEAST` networks are known.
        """
        networks = {one.source: one for one in trained}
        known = [(one.features, one.fitness) for one in networks.values() if math.isfinite(one.fitness)]
        if len(known) < LEAST:
            return lambda admitted: False
        surrogate = fit(known)
        most = quantile([surrogate.predict(one) for one, _ in known], 1 - self.part)
        return lambda admitted: admitted.source not in networks and surrogate.predict(features(admitted.profile)) > most


def features(profile: Profile) -> dict[str, float]:
    """Return what the surrogate sees of a network; operations that it does not call are 0, and left out.

    They are, as log(1 + x), the calls of each operation, parameters, FLOPs of an image in training mode, the most
    channels of a convolution and the most features of a hidden layer; the highest rate of a dropout; and the number of
    calls with weights.
    """
    graph = profile.graph
    logarithmic = {f"calls of {name}": count for name, count in Counter(step.op for step in profile.steps).items()}
    logarithmic |= {"parameters": profile.parameters, "flops": profile.training_flops}
    logarithmic |= {"channels": max(graph.channels, default=0), "hidden": max(graph.hidden, default=0)}
    return {name: rounded(math.log1p(count)) for name, count in logarithmic.items()} | {
        "dropout": max((step.rate for step in profile.steps), default=0.0),
        "weighted": float(sum(node.weighted for node in graph.nodes)),
    }


def fit(networks: Sequence[tuple[Mapping[str, float], float]]) -> Surrogate:
    """Fit the surrogate to the `features` and the fitness of networks, at least one; a fitness is finite, >= 0."""
    logs = [rounded(math.log(max(fitness, _LOWEST))) for _, fitness in networks]
    constant = _mean(logs)
    residuals = [log - constant for log in logs]
    names, columns, scales = [], [], []
    for name in sorted({name for known, _ in networks for name in known}):
        values = [known.get(name, 0.0) for known, _ in networks]
        if min(values) < max(values):
            mean = _mean(values)
            apart = [value - mean for value in values]
            scale = math.sqrt(_dot(apart, apart) / len(apart))  # not `** 2`, which is the C library's
            names.append(name)
            scales.append((mean, scale))
            columns.append([value / scale for value in apart])
    matrix = [[_dot(row, column) + ALPHA * (row is column) for column in columns] for row in columns]
    weights = _solve(matrix, [_dot(column, residuals) for column in columns])
    terms = tuple((name, *scale, weight) for name, scale, weight in zip(names, scales, weights, strict=True))
    return Surrogate(terms=terms, constant=constant)


def quantile(values: Sequence[float], part: float) -> float:
    """Return the value that a part of the values, in [0, 1], lies below, interpolated linearly; equal to equal ones."""
    ordered, position = sorted(values), part * (len(values) - 1)
    below = int(position)
    low, high = ordered[below], ordered[min(below + 1, len(ordered) - 1)]
    return low + (high - low) * (position - below)


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)


def _dot(one: Sequence[float], other: Sequence[float]) -> float:
    return math.fsum(a * b for a, b in zip(one, other, strict=True))


def _solve(matrix: list[list[float]], right: Sequence[float]) -> list[float]:
    """Solve a system whose matrix is symmetric with eigenvalues >= `ALPHA`; so no pivot is near 0."""
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    for at, pivot in enumerate(rows):
        for row in rows[at + 1 :]:
            factor = row[at] / pivot[at]
            row[at:] = [value - factor * above for value, above in zip(row[at:], pivot[at:], strict=True)]
    solution = [0.0] * len(rows)
    for at, row in reversed(list(enumerate(rows))):
        solution[at] = (row[-1] - _dot(row[at + 1 : -1], solution[at + 1 :])) / row[at]
    return solution
