"""CVT MAP-Elites: one elite in each niche of a centroidal Voronoi tessellation of [0, 1]^d.

Vassiliades, Chatzilygeroudis and Mouret 2018, arXiv:1610.05729. The archive of networks and the archive of
prompts are both this one; they differ in what their axes mean. `TopK` is the archive without niches that an
ablation puts in its place: the best networks, wherever they lie.
"""

import math
from bisect import bisect_left
from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import islice
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tacevo import parts
from tacevo.randomness import derived_seed, stream
from tacevo.records import Record, to_json
from tacevo.storage.canonical import content_hash

K = TypeVar("K", bound=Hashable)

V = TypeVar("V")

#: Coordinates of a point, shape (d,).
Point = tuple[float, ...]


class PersistentMap(Mapping[K, V]):
    """A mapping without a way to change it, whose keys are in the order in which they first came.

    Mappings that grew from one another share one log of writes, to which only the longest of them appends; each knows
    how many writes it is made of, and so stays what it was. One that grows a second time copies its part of the log
    first. The log keeps values that were replaced.
    """

    __slots__ = ("_indices", "_keys", "_log", "_writes")

    def __init__(self) -> None:
        self._log: list[V] = []
        #: The indices in the log of the values of a key, in order.
        self._indices: dict[K, list[int]] = {}
        #: The number of writes, and of keys, that are this mapping's own.
        self._writes = self._keys = 0

    def adding(self, key: K, value: V) -> "PersistentMap[K, V]":
        """Return the mapping with a value under a key, new or instead of its former value; this one stays as it is."""
        grown: PersistentMap[K, V] = PersistentMap()
        if self._writes == len(self._log):
            grown._log, grown._indices = self._log, self._indices
        else:
            grown._log, grown._indices = list(self.values()), {name: [index] for index, name in enumerate(self)}
        indices = grown._indices.setdefault(key, [])
        indices.append(len(grown._log))
        grown._log.append(value)
        grown._writes, grown._keys = len(grown._log), self._keys + (len(indices) == 1)
        return grown

    def __getitem__(self, key: K) -> V:
        """Return the value of a key.

        Raises:
            KeyError: the key is not in it.
        """
        if self._writes == len(self._log):  # nothing has grown from it, as is usual
            return self._log[self._indices[key][-1]]
        indices = self._indices.get(key, [])
        own = bisect_left(indices, self._writes)
        if own == 0:
            raise KeyError(key)
        return self._log[indices[own - 1]]

    def __iter__(self) -> Iterator[K]:
        """Iterate over the keys in the order in which they first came."""
        return iter(list(islice(self._indices, self._keys)))

    def __len__(self) -> int:
        """Return the number of keys."""
        return self._keys


#: Points whose distances are in memory together.
_AT_ONCE = 1_000


class AddStatus(StrEnum):
    """The result of an insertion; `rejected` leaves the archive as it was."""

    new = "new"
    improved = "improved"
    rejected = "rejected"


@dataclass(frozen=True, slots=True, kw_only=True)
class Elite:
    """The occupant of a niche."""

    name: str
    #: The quantity by which elites of one niche compete; higher is better.
    objective: float


@dataclass(frozen=True, slots=True)
class Archive:
    """The elites, by niche."""

    elites: PersistentMap[int, Elite] = field(default_factory=PersistentMap)


class Tessellation:
    """The niches, by their centroids of shape (niches, d): which of them a point of [0, 1]^d is nearest to."""

    def __init__(self, centroids: Sequence[Sequence[float]] | NDArray[np.float64]) -> None:
        self.centroids = np.asarray(centroids, dtype=np.float64)

    @property
    def niches(self) -> int:
        """The number of niches."""
        return len(self.centroids)

    def niche_of(self, point: Sequence[float]) -> int:
        """Find the niche of a point of shape (d,): that of the nearest centroid, of equally near ones the first.

        Raises:
            ValueError: a coordinate is NaN or infinite, or their number is not d.
        """
        return self.niches_of([point])[0]

    def niches_of(self, points: Sequence[Sequence[float]]) -> list[int]:
        """Find the niches of points of shape (n, d) in one go; raises as `niche_of` does."""
        dimensions = self.centroids.shape[1]
        for point in points:
            if len(point) != dimensions or not all(math.isfinite(value) for value in point):
                raise ValueError(f"a point needs {dimensions} finite coordinates; got {tuple(point)}")
        coordinates = np.asarray(points, dtype=np.float64).reshape(-1, dimensions)
        niches: list[int] = []
        # A tree would take longer to import than a search takes to look through some hundred centroids.
        for part in np.split(coordinates, range(_AT_ONCE, len(coordinates), _AT_ONCE)):
            distances = ((part[:, None] - self.centroids) ** 2).sum(axis=2)
            niches += distances.argmin(axis=1).tolist()
        return niches


def find_centroids(*, niches: int, dimensions: int, samples: int, seed: int) -> list[list[float]]:
    """Spread centroids evenly over the unit cube by k-means on uniform samples.

    k-means differs in its last bits between CPUs. The result is rounded, which hides most of that, and stored,
    which hides the rest: a replayed run reads the centroids of its recording.

    Returns:
        Centroids, shape (niches, dimensions), in [0, 1], rounded to 9 decimals.
    """
    from sklearn.cluster import KMeans  # a second to import, needed once per archive shape

    points = stream(seed, "centroids", niches, dimensions, samples).random((samples, dimensions))
    means = KMeans(niches, n_init=1, random_state=derived_seed(seed, "k-means") % 2**32).fit(points)
    return [[round(float(value), 9) for value in centroid] for centroid in means.cluster_centers_]


@dataclass(frozen=True)
class Cvt(parts.Archive):
    """The paper's niches, spread evenly by k-means (`find_centroids`)."""

    #: Uniform points, and their seed.
    samples: int
    seed: int

    def centroids(self, niches: int, axes: int) -> list[list[float]]:
        """Return the centroids."""
        return find_centroids(niches=niches, dimensions=axes, samples=self.samples, seed=self.seed)


@dataclass(frozen=True)
class Fittest(parts.Archive):
    """A control without niches: the best networks (`TopK`)."""

    has_niches = False


def insert(archive: Archive, niche: int, elite: Elite) -> tuple[Archive, AddStatus]:
    """Offer an elite to a niche; return the archive that results.

    The incumbent keeps its niche on a tie, so the order of arrival is part of the result and replay must
    preserve it.

    Raises:
        ValueError: the objective is NaN, which can be compared with nothing.
    """
    if math.isnan(elite.objective):
        raise ValueError(f"the objective of {elite.name} must be a number; got nan")
    incumbent = archive.elites.get(niche)
    if incumbent is not None and elite.objective <= incumbent.objective:
        return archive, AddStatus.rejected
    grown = Archive(archive.elites.adding(niche, elite))
    return grown, AddStatus.new if incumbent is None else AddStatus.improved


@dataclass(frozen=True, slots=True, kw_only=True)
class TopK:
    """An archive without niches: so many places for the best networks of all."""

    #: The number of niches, at least 1.
    niches: int

    def index_of(self, archive: Archive, newcomer: Elite) -> int:
        """Find the place that a newcomer competes for; `insert` then decides as in a niche.

        One exactly as fit as a network that is kept competes with that one, and loses the tie: a network that comes
        twice, which has the same fitness twice, holds one place only. Any other takes the first empty place; where
        there is none, it competes with the least fit.
        """
        for index, elite in archive.elites.items():
            if elite.objective == newcomer.objective:
                return index
        if len(archive.elites) < self.niches:
            return len(archive.elites)
        return min(archive.elites, key=lambda index: archive.elites[index].objective)


def coverage(archive: Archive, niches: int) -> float:
    """Return the part of the niches, or places, that is occupied, in [0, 1]."""
    return len(archive.elites) / niches


def qd_score(archive: Archive) -> float:
    """Sum the quality of all elites (Pugh, Soros and Stanley 2016, doi:10.3389/frobt.2016.00040).

    An objective is the negative of a loss f >= 0. Its quality is 1 / (1 + f), in (0, 1]; so a further elite never
    lowers the score.
    """
    return math.fsum(1.0 / (1.0 - elite.objective) for elite in archive.elites.values())


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisBounds(Record):
    """The range of each descriptor that min-max normalisation maps to [0, 1]."""

    low: Point
    high: Point

    def covering(self, point: Point) -> "AxisBounds":
        """Widen the bounds just so far that they contain a point."""
        low = tuple(map(min, self.low, point))
        high = tuple(map(max, self.high, point))
        return self if (low, high) == (self.low, self.high) else AxisBounds(low=low, high=high)

    def normalise(self, point: Point) -> Point:
        """Map a point into [0, 1]^d; outside the bounds it is clipped, and an axis without extent gives 0.5."""
        axes = zip(point, self.low, self.high, strict=True)
        return tuple(min(max((x - a) / (b - a), 0.0), 1.0) if b > a else 0.5 for x, a, b in axes)


@dataclass(frozen=True, slots=True, kw_only=True)
class Individual:
    """A candidate as the network archive sees it."""

    elite: Elite
    #: Descriptors before normalisation.
    point: Point


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkArchive:
    """A_N: an archive under min-max bounds that may move.

    When a candidate lies outside the bounds of all candidates before it, the bounds move, every normalised
    descriptor changes, and the archive is rebuilt by re-inserting all candidates in order (docs/paper.md).
    """

    archive: Archive = field(default_factory=Archive)
    #: The bounds of the axes; None until the first candidate arrives, and for an archive without niches.
    bounds: AxisBounds | None = None
    #: Bounds given by the config never move.
    fixed: bool = False
    #: Every candidate offered so far by its name, in order.
    history: PersistentMap[str, Individual] = field(default_factory=PersistentMap)

    @property
    def digest(self) -> str:
        """The hash of its elites by niche, for the ledger: 64 hex digits."""
        return content_hash(to_json(self.archive.elites))

    def offer(self, niches: Tessellation | TopK, newcomer: Individual) -> tuple["NetworkArchive", int, AddStatus]:
        """Offer a candidate.

        Returns:
            The archive that results, the newcomer's niche or place in it, and what the insertion did.
        """
        if isinstance(niches, Tessellation):
            return self._offer_to_niche(niches, newcomer)
        index = niches.index_of(self.archive, newcomer.elite)
        archive, status = insert(self.archive, index, newcomer.elite)
        return replace(self, archive=archive, history=self._with(newcomer)), index, status

    def _offer_to_niche(self, niches: Tessellation, newcomer: Individual) -> tuple["NetworkArchive", int, AddStatus]:
        bounds = self.bounds or AxisBounds(low=newcomer.point, high=newcomer.point)
        archive = self.archive
        if not self.fixed:
            bounds = bounds.covering(newcomer.point)
            if bounds != self.bounds:
                archive = _rebuilt(niches, bounds, self.history.values())
        niche = niches.niche_of(bounds.normalise(newcomer.point))
        archive, status = insert(archive, niche, newcomer.elite)
        return replace(self, archive=archive, bounds=bounds, history=self._with(newcomer)), niche, status

    def _with(self, newcomer: Individual) -> PersistentMap[str, Individual]:
        return self.history.adding(newcomer.elite.name, newcomer)


def _rebuilt(tessellation: Tessellation, bounds: AxisBounds, history: Collection[Individual]) -> Archive:
    """Re-insert all candidates, in order, under other bounds."""
    archive = Archive()
    niches = tessellation.niches_of([bounds.normalise(one.point) for one in history])
    for niche, one in zip(niches, history, strict=True):
        archive, _ = insert(archive, niche, one.elite)
    return archive


def best_distinct(elites: Iterable[tuple[float, str, str | None]], baseline: str | None) -> list[str]:
    """Rank elites, and pass over those whose source is the baseline's or a better elite's; return ids, best first.

    Each elite comes as fitness (lower is better), id and source, in any order. The earlier candidate wins a tie.
    """
    seen, chosen = {baseline}, []
    for _, name, source in sorted(elites, key=lambda elite: elite[:2]):
        if source not in seen:
            seen.add(source)
            chosen.append(name)
    return chosen
