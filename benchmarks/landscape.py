"""A landscape with known truth: a made-up fitness over both descriptors, with noise as loud as one wishes.

A network is a point of the unit square. Its training gives a loss whose logarithm is the landscape's there, plus normal
noise of the seed. So a search of thousands of candidates takes seconds, and what it should have found is known.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from fractions import Fraction
from hashlib import blake2b
from statistics import NormalDist, median

import numpy as np
from numpy.typing import NDArray

from tacevo.choices import ParentPolicy
from tacevo.evolution.archive import Archive, Bounds, Elite, Individual, NetworkArchive, Tessellation
from tacevo.evolution.proposals import Candidate, draw_parents, pool_of_parents
from tacevo.randomness import stream

Floats = NDArray[np.float64]

#: Where good networks lie: places in the unit square, and how wide around them. The first one is the best.
_PLACES, _WIDTHS = np.array([[0.8, 0.3], [0.25, 0.75], [0.6, 0.8]]), np.array([0.08, 0.2, 0.15])
_DEPTHS = np.array([1.0, 0.6, 0.4])

#: The point of the baseline, where the landscape is nearly flat.
BASELINE = np.array([0.1, 0.1])

#: Of a mutation, in both descriptors.
_STEP = 0.1

#: Mutations of the baseline that every search begins with.
INITIAL = 10

_NORMAL = NormalDist()


class Strategy(StrEnum):
    """Where the parents of a candidate come from, and what a fitness is."""

    #: The archive: the best of each niche.
    elites = "elites of the niches"
    #: The same, of which every fourth training is another one of an elite.
    extract = "elites, trained again (extract)"
    #: The same, each candidate with three seeds; so there are a third as many.
    three_seeds = "elites, three seeds"
    #: Any candidate before: variation without selection.
    drift = "any candidate (drift)"
    #: The best of all, as many as there are elites: selection without niches.
    best_k = "the best of all (best_k)"
    #: The fittest of some draws from the youngest.
    regularised_evolution = "winners of tournaments (regularised evolution)"
    #: One step from the baseline.
    baseline = "the baseline"
    #: None: every candidate is drawn at random.
    random = "none, drawn at random"


#: Those whose parents are not elites.
_POLICIES = {
    Strategy.drift: ParentPolicy.trained,
    Strategy.best_k: ParentPolicy.best_k,
    Strategy.regularised_evolution: ParentPolicy.tournament,
    Strategy.baseline: ParentPolicy.baseline,
    Strategy.random: ParentPolicy.none,
}

#: As conf/ has them.
_POPULATION, _TOURNAMENT = 100, 25


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

    def evaluate(self, point: Floats, seed: int, trainings: Iterable[int]) -> list[float]:
        """Return the losses of a network under training seeds that follow from a run's, which are numbered.

        As in the project, an evaluation follows from the network and its training seed: who asks again gets it again,
        in whatever arm.
        """
        truth = float(self.truth(point[None])[0])
        keys = (blake2b(point.tobytes() + repr((seed, number)).encode(), digest_size=6) for number in trainings)
        chances = ((int.from_bytes(key.digest()) + 0.5) / 2**48 for key in keys)
        return [truth * math.exp(self.noise * _NORMAL.inv_cdf(chance)) for chance in chances]

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
    landscape: Landscape, strategy: Strategy, niches: Tessellation, trainings: int, seed: int, *, another: int = 0
) -> Searched:
    """Search the landscape as the project does: one candidate after another, each into a network archive.

    Searches of one seed share what their strategies leave alone, as the arms of a sweep do: the candidates of
    generation 0, the draws of parents and mutations, and evaluations of equal networks.

    Args:
        landscape: the truth.
        strategy: where parents come from, and how often a network is trained.
        niches: of the archive, over the unit square.
        trainings: beside those of the baseline.
        seed: of parents, mutations and trainings.
        another: numbers the draws after generation 0, so that a strategy can be run twice on one seed.
    """
    archive = NetworkArchive(bounds=Bounds(low=(0.0, 0.0), high=(1.0, 1.0)), fixed=True)
    candidates: dict[str, Candidate] = {}
    points: list[Floats] = []
    losses: list[list[float]] = []
    each = 3 if strategy is Strategy.three_seeds else 1
    count = trainings // each + 1
    first, later = stream(seed, "initial"), stream(seed, "later", another)
    steps = _STEP * np.concatenate([first.normal(size=(INITIAL, 2)), later.normal(size=(count, 2))])
    places = later.random((count, 2))
    for number in range(count):
        if strategy is Strategy.extract and number > INITIAL and number % 4 == 3:
            names = [int(elite.name) for elite in archive.archive.elites.values()]
            order = stream(seed, "again", another, number).permutation(names).tolist()
            again = min(order, key=lambda name: len(losses[name]))
            losses[again] += landscape.evaluate(points[again], seed, [len(losses[again])])
            loss = median(losses[again])
            archive = archive.reestimated(niches, [str(again)], -loss)
            candidates[str(again)] = replace(candidates[str(again)], fitness=loss)
            continue
        if number == 0:
            point = BASELINE
        elif number > INITIAL and strategy is Strategy.random:
            point = places[number - 1]
        else:
            parent = 0
            if number > INITIAL and strategy is not Strategy.baseline:
                parent = _parent(strategy, archive, candidates, stream(seed, "parents", another, number))
            point = np.clip(points[parent] + steps[number - 1], 0.0, 1.0)
        name = str(len(points))
        points.append(point)
        losses.append(landscape.evaluate(point, seed, range(each)))
        newcomer = Candidate(id=name, source=name, fitness=median(losses[-1]), curiosities=Fraction(0))
        candidates[name] = newcomer
        elite = Elite(name=name, objective=-newcomer.fitness)
        archive, _, _ = archive.offer(niches, Individual(elite=elite, point=(float(point[0]), float(point[1]))))
    return Searched(points=np.array(points), fitness=np.array([median(of) for of in losses]), archive=archive.archive)


def _parent(
    strategy: Strategy, archive: NetworkArchive, candidates: Mapping[str, Candidate], rng: np.random.Generator
) -> int:
    """Draw the parent of the next candidate as a search does; return its place among the candidates."""
    policy = _POLICIES.get(strategy, ParentPolicy.uniform)
    pool = pool_of_parents(policy, candidates, archive.archive, population=_POPULATION)
    (parent,) = draw_parents(policy, pool, number=1, best=len(pool), tournament=_TOURNAMENT, rng=rng)
    return int(parent.id)
