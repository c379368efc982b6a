"""A landscape with known truth: a made-up fitness over both descriptors, with noise as loud as one wishes.

A network is a point of the unit square. Its training gives a loss whose logarithm is the landscape's there, plus normal
noise of the seed. So a search of thousands of candidates takes seconds, and what it should have found is known.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from tacevo.search.archive import Bounds, Elite, NetworkArchive, Placed, Tessellation

Floats = NDArray[np.float64]

#: Where good networks lie: places in the unit square, and how wide around them. The first one is the best.
_PLACES, _WIDTHS = np.array([[0.8, 0.3], [0.25, 0.75], [0.6, 0.8]]), np.array([0.08, 0.2, 0.15])
_DEPTHS = np.array([1.0, 0.6, 0.4])

#: The point of the baseline, where the landscape is nearly flat.
BASELINE = np.array([0.1, 0.1])

#: Of a mutation, in both descriptors.
_STEP = 0.1


class Strategy(StrEnum):
    """Where the parents of a candidate come from."""

    #: The archive: the best of each niche.
    elites = "elites of the niches"
    #: Any candidate before: variation without selection.
    drift = "any candidate"
    #: None: every candidate is drawn at random.
    random = "none, drawn at random"


@dataclass(frozen=True, slots=True, kw_only=True)
class Landscape:
    """The truth."""

    #: How much less the logarithm of the loss is at the best place than far from all; 0 is a flat landscape.
    signal: float
    #: Standard deviation of the logarithm of the loss between training seeds.
    noise: float

    def truth(self, points: Floats) -> Floats:
        """Return the median loss of networks, shape (n,), at points of shape (n, 2)."""
        distances = ((points[:, None, :] - _PLACES[None]) ** 2).sum(axis=2)
        return np.asarray(np.exp(-self.signal * (_DEPTHS * np.exp(-distances / (2 * _WIDTHS**2))).max(axis=1)))

    def train(self, points: Floats, seeds: int, rng: np.random.Generator) -> Floats:
        """Return the losses of networks under so many seeds of their own, shape (n, seeds)."""
        return self.truth(points)[:, None] * np.exp(self.noise * rng.normal(size=(len(points), seeds)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Searched:
    """What a search saw: every candidate, the baseline first."""

    #: Shape (n, 2).
    points: Floats
    #: The recorded fitness of each, shape (n,).
    fitness: Floats

    @property
    def best(self) -> int:
        """The candidate of the lowest recorded fitness."""
        return int(self.fitness.argmin())


def search(
    landscape: Landscape, strategy: Strategy, niches: Tessellation, candidates: int, rng: np.random.Generator
) -> Searched:
    """Search the landscape as the project does: one candidate after another, one seed each, into a network archive.

    Args:
        landscape: the truth.
        strategy: where parents come from.
        niches: of the archive, over the unit square.
        candidates: beside the baseline.
        rng: of parents, mutations and seeds.
    """
    archive = NetworkArchive(bounds=Bounds(low=(0.0, 0.0), high=(1.0, 1.0)), fixed=True)
    points = np.empty((candidates + 1, 2))
    fitness = np.empty(candidates + 1)
    for number in range(candidates + 1):
        points[number] = _candidate(number, strategy, archive, points, rng)
        fitness[number] = landscape.train(points[number : number + 1], 1, rng)[0, 0]
        newcomer = Elite(name=str(number), objective=-float(fitness[number]))
        point = (float(points[number, 0]), float(points[number, 1]))
        archive, _, _ = archive.offer(niches, Placed(elite=newcomer, point=point))
    return Searched(points=points, fitness=fitness)


def _candidate(
    number: int, strategy: Strategy, archive: NetworkArchive, points: Floats, rng: np.random.Generator
) -> Floats:
    """Return the point of the next candidate; the first one is the baseline."""
    if number == 0:
        return BASELINE
    match strategy:
        case Strategy.random:
            return rng.random(2)
        case Strategy.drift:
            parent = int(rng.integers(number))
        case Strategy.elites:
            elites = list(archive.archive.elites.values())
            parent = int(elites[rng.integers(len(elites))].name)
    return np.asarray(np.clip(points[parent] + _STEP * rng.normal(size=2), 0.0, 1.0))
