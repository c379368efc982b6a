"""A landscape with known truth: a made-up fitness over both descriptors, with noise as loud as one wishes.

A network is a point of the unit square. Its training gives a loss whose logarithm is the landscape's there, plus normal
noise of the seed. So a search of thousands of candidates takes seconds, and what it should have found is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from statistics import median

import numpy as np
from numpy.typing import NDArray

from tacevo.search.archive import Archive, Bounds, Elite, NetworkArchive, Placed, Tessellation

Floats = NDArray[np.float64]

#: Where good networks lie: places in the unit square, and how wide around them. The first one is the best.
_PLACES, _WIDTHS = np.array([[0.8, 0.3], [0.25, 0.75], [0.6, 0.8]]), np.array([0.08, 0.2, 0.15])
_DEPTHS = np.array([1.0, 0.6, 0.4])

#: The point of the baseline, where the landscape is nearly flat.
BASELINE = np.array([0.1, 0.1])

#: Of a mutation, in both descriptors.
_STEP = 0.1


class Strategy(StrEnum):
    """Where the parents of a candidate come from, and what a fitness is."""

    #: The archive: the best of each niche.
    elites = "elites of the niches"
    #: The same, of which every fourth training is another one of an elite.
    extract = "elites, trained again (extract)"
    #: The same, each candidate with three seeds; so there are a third as many.
    three_seeds = "elites, three seeds"
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
    #: What the search knew of the fitness of each at its end, shape (n,).
    fitness: Floats
    #: Its last archive, whose elites are named by their places among the candidates.
    archive: Archive

    @property
    def best(self) -> int:
        """The candidate of the lowest recorded fitness."""
        return int(self.fitness.argmin())


def search(
    landscape: Landscape, strategy: Strategy, niches: Tessellation, trainings: int, rng: np.random.Generator
) -> Searched:
    """Search the landscape as the project does: one candidate after another, each into a network archive.

    Args:
        landscape: the truth.
        strategy: where parents come from, and how often a network is trained.
        niches: of the archive, over the unit square.
        trainings: beside those of the baseline.
        rng: of parents, mutations and seeds.
    """
    archive = NetworkArchive(bounds=Bounds(low=(0.0, 0.0), high=(1.0, 1.0)), fixed=True)
    points: list[Floats] = []
    losses: list[list[float]] = []
    seeds = 3 if strategy is Strategy.three_seeds else 1
    for number in range(trainings // seeds + 1):
        if strategy is Strategy.extract and number % 4 == 3:
            names = [int(elite.name) for elite in archive.archive.elites.values()]
            again = min(rng.permutation(names).tolist(), key=lambda name: len(losses[name]))
            losses[again].append(float(landscape.train(points[again][None], 1, rng)[0, 0]))
            archive = archive.reestimated(niches, [str(again)], -median(losses[again]))
            continue
        point = _candidate(strategy, archive, points, rng)
        losses.append(landscape.train(point[None], seeds, rng)[0].tolist())
        newcomer = Elite(name=str(len(points)), objective=-median(losses[-1]))
        points.append(point)
        archive, _, _ = archive.offer(niches, Placed(elite=newcomer, point=(float(point[0]), float(point[1]))))
    return Searched(points=np.array(points), fitness=np.array([median(of) for of in losses]), archive=archive.archive)


def _candidate(
    strategy: Strategy, archive: NetworkArchive, points: Sequence[Floats], rng: np.random.Generator
) -> Floats:
    """Return the point of the next candidate; the first one is the baseline."""
    if not points:
        return BASELINE
    match strategy:
        case Strategy.random:
            return rng.random(2)
        case Strategy.drift:
            parent = int(rng.integers(len(points)))
        case _:
            elites = list(archive.archive.elites.values())
            parent = int(elites[rng.integers(len(elites))].name)
    return np.asarray(np.clip(points[parent] + _STEP * rng.normal(size=2), 0.0, 1.0))
