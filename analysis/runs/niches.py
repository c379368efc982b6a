"""The niches of a run's archives: their centroids, their cells of the unit square, and which prompts could reach.

A temperature rule leads to few of the temperatures, so a run reaches only some niches of its prompt archive.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Voronoi

from tacevo.config.recorded_parts import centroids_asked, decision
from tacevo.config.schema import ArchiveConfig
from tacevo.errors import RunError, StoreError
from tacevo.evolution.archive import Tessellation, find_centroids
from tacevo.evolution.prompts import prompt_point
from tacevo.evolution.temperatures import clip
from tacevo.parts import Generation
from tacevo.parts.kinds import TEMPERATURES
from tacevo.parts.registry import of_settings
from tacevo.results.run import RecordedRun
from tacevo.storage.canonical import content_hash
from tacevo.storage.store import Store
from tacevo.typed import convert

#: Corners of a convex polygon in order, shape (corners, 2).
Polygon = NDArray[np.float64]


#: The most distances that k-means may compute in every round, niches x samples: the paper's archive takes two millions.
_MOST_DISTANCES = 100_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Niches:
    """The centroids of both archives, each shape (niches, axes), in [0, 1]; none where there are no niches."""

    networks: NDArray[np.float64]
    prompts: NDArray[np.float64]


def load_niches(run: RecordedRun) -> Niches:
    """Find the centroids that a run was searched with; where its store has none, they are computed as they were.

    Raises:
        RunError: they are not those of the run's ledger.
        StoreError: the store's entry is damaged.
    """
    root, archive = run.stores, run.config.archive
    networks: list[list[float]] = []
    if archive.kind in run.config.code:
        networks = _decided(run)
    elif run.has_niches:
        networks = _centroids(root, archive, archive.niches, len(archive.axes))
    prompts = _centroids(root, archive, archive.prompt_niches, 2)
    if content_hash([networks, prompts]) != run.header.centroids:
        raise RunError(
            "centroids of another hash, in the store and computed on this machine",
            place=str(root),
            expected=f"the niches that {run.path} was searched with, of hash {run.header.centroids[:12]}",
            remedy="name the run's own stores with --store",
        )
    return Niches(networks=np.array(networks).reshape(-1, len(archive.axes)), prompts=np.array(prompts))


def cells(centroids: NDArray[np.float64]) -> tuple[Polygon, ...]:
    """Cut the unit square into the Voronoi cells of points in it.

    Each point is mirrored at the four sides, so that the sides become borders between a point and its image, and
    no cell of a point itself goes beyond them.

    Args:
        centroids: shape (niches, 2), inside (0, 1).

    Returns:
        One polygon for each point, in their order; together they cover the square once.
    """
    mirrored = [centroids * flip + shift for flip, shift in _MIRRORS]
    diagram = Voronoi(np.concatenate([centroids, *mirrored]))
    return tuple(
        _in_order(np.clip(diagram.vertices[diagram.regions[diagram.point_region[number]]], 0.0, 1.0), centroid)
        for number, centroid in enumerate(centroids)
    )


#: The maps that mirror a point at the left, right, lower and upper side: a factor and a shift.
_MIRRORS = [
    (np.array([-1.0, 1.0]), np.array([0.0, 0.0])),
    (np.array([-1.0, 1.0]), np.array([2.0, 0.0])),
    (np.array([1.0, -1.0]), np.array([0.0, 0.0])),
    (np.array([1.0, -1.0]), np.array([0.0, 2.0])),
]


def _centroids(root: Path, archive: ArchiveConfig, niches: int, dimensions: int) -> list[list[float]]:
    shape = {"niches": niches, "dimensions": dimensions, "samples": archive.samples, "seed": archive.seed}
    stored = Store(root, "centroids").read(shape)
    if stored is None and niches * archive.samples > _MOST_DISTANCES:
        expected = f"the centroids of {niches} niches, which take too long to compute again"
        raise RunError("none", place=str(root), expected=expected, remedy="name the run's own stores with --store")
    if stored is None:
        return find_centroids(**shape)
    return convert(list[list[float]], stored, place="centroids", error=StoreError)


def _decided(run: RecordedRun) -> list[list[float]]:
    """Read the centroids that a part decided which the run's user brought; nothing of it runs."""
    config = run.config
    name = config.archive.kind
    method, given = centroids_asked(config)
    question = decision(config.code[name].sha256, config.parts.get(name, {}), method, given)
    stored = Store(run.stores, "decisions").read(question)
    return convert(list[list[float]], stored or [], place="centroids", error=StoreError)


def _in_order(corners: Polygon, centre: NDArray[np.float64]) -> Polygon:
    across, up = (corners - centre).T
    return corners[np.argsort(np.arctan2(up, across))]


def reachable_temperatures(run: RecordedRun) -> frozenset[float]:
    """Return every T_g that a trial of the run could have had, with any fitness that its generations found.

    A generation brings a better best or the same. Trials begin with generation 1, at T_1; the noise of a request does
    not enter the prompt archive. Of a rule that a user brought, nobody knows what else it could have said: these are
    the temperatures that it had.
    """
    settings = run.config.temperature
    if settings.rule not in TEMPERATURES.ours:
        return frozenset(line.temperature for line in run.generations[1:])
    rule = of_settings(TEMPERATURES, settings.rule, settings)
    reached: set[float] = set()
    current = {settings.start}
    for _ in range(run.generations[-1].generation):
        reached |= current
        current = {clip(rule.next(_ended(before, best))) for before in current for best in (0.5, 1.0)}
    return frozenset(reached)


def _ended(temperature: float, best: float) -> Generation:
    """Return a generation that found this best after one of 1."""
    counts = {"candidates": 1, "trained": 1, "inserted": 1}
    return Generation(number=1, temperature=temperature, best=best, best_before=1.0, **counts)


def reachable_prompt_niches(run: RecordedRun, centroids: NDArray[np.float64]) -> frozenset[int]:
    """Return the niches that hold some instruction at one of `reachable_temperatures`.

    The centroids are those of the prompt archive, shape (niches, 2), in [0, 1].
    """
    prompts = len(run.instructions)
    points = [
        prompt_point(prompt, temperature, prompts=prompts)
        for prompt in range(prompts)
        for temperature in reachable_temperatures(run)
    ]
    return frozenset(Tessellation(centroids).niches_of(points))


def prompt_rows(centroids: NDArray[np.float64], prompts: int) -> tuple[tuple[tuple[int, float, float], ...], ...]:
    """Cut the temperatures of each instruction, [0, 1], into the niches that hold them.

    An instruction is a number on the first axis of the prompt archive, and between two of them there is nothing: so the
    archive is these rows, and its cells are wider than what they can hold.

    Args:
        centroids: those of the prompt archive, shape (niches, 2), in [0, 1].
        prompts: the number of instructions.

    Returns:
        Of each instruction (niche, lowest temperature, highest temperature), rising in the temperature.
    """
    return tuple(_cut_at(centroids, prompt_point(prompt, 0.0, prompts=prompts)[0]) for prompt in range(prompts))


def _cut_at(centroids: NDArray[np.float64], across: float) -> tuple[tuple[int, float, float], ...]:
    """Cut the line of one first coordinate where it leaves the cell of one centroid for that of another."""
    offsets = ((centroids[:, 0] - across) ** 2) + centroids[:, 1] ** 2
    cut = []
    for niche, (offset, height) in enumerate(zip(offsets, centroids[:, 1], strict=True)):
        # The square distances of two centroids to the point (across, t) differ by a linear function of t.
        slopes, rises = 2 * (centroids[:, 1] - height), offsets - offset
        below, above = rises[slopes > 0] / slopes[slopes > 0], rises[slopes < 0] / slopes[slopes < 0]
        low, high = max([0.0, *above]), min([1.0, *below])
        nearer = (rises < 0) | ((rises == 0) & (np.arange(len(centroids)) < niche))  # of equals the first one counts
        if low < high and not (nearer & (slopes == 0)).any():
            cut.append((niche, float(low), float(high)))
    return tuple(sorted(cut, key=lambda piece: piece[1]))
