"""The archive is CVT MAP-Elites, niche for niche and occupant for occupant, as pyribs has it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ribs.archives import CVTArchive
from scipy.spatial import cKDTree

from tacevo.evolution.archive import (
    AddStatus,
    Archive,
    AxisBounds,
    Elite,
    Individual,
    NetworkArchive,
    Tessellation,
    TopK,
    coverage,
    find_centroids,
    insert,
    qd_score,
)
from tacevo.randomness import stream

QUARTERS = Tessellation([[0.25, 0.25], [0.25, 0.75], [0.75, 0.25], [0.75, 0.75]])

UNIT = st.floats(0, 1)


def elite(name: str, objective: float) -> Elite:
    """Write an elite briefly."""
    return Elite(name=name, objective=objective)


def individual(name: str, objective: float, point: tuple[float, float]) -> Individual:
    """Write a candidate briefly."""
    return Individual(elite=elite(name, objective), point=point)


@pytest.mark.slow
def test_hundred_thousand_insertions_agree_with_pyribs() -> None:
    """Same niches, same occupants, same coverage and QD-score as pyribs' CVTArchive on the same centroids."""
    centroids = np.array(find_centroids(niches=100, dimensions=2, samples=10_000, seed=0))
    rng = stream(0, "pyribs")
    points, objectives = rng.random((100_000, 2)), rng.integers(0, 2_000, 100_000) / 2_000  # with many ties
    ours, tessellation = Archive(), Tessellation(centroids)
    peer = CVTArchive(solution_dim=1, centroids=centroids, ranges=[(0, 1), (0, 1)])
    niches = [tessellation.niche_of(point) for point in points]
    assert niches == peer.index_of(points).tolist()
    for index, niche in enumerate(niches):
        ours, status = insert(ours, niche, elite(str(index), float(objectives[index])))
        result = peer.add_single([index], 1 / (1 - objectives[index]), points[index])
        assert status is list((AddStatus.rejected, AddStatus.improved, AddStatus.new))[int(result["status"])]
    theirs = zip(peer.data("index"), peer.data("solution"), strict=True)
    occupants = {int(niche): str(int(solution[0])) for niche, solution in theirs}
    assert {niche: occupant.name for niche, occupant in ours.elites.items()} == occupants
    assert coverage(ours, 100) == peer.stats.coverage
    assert qd_score(ours) == pytest.approx(peer.stats.qd_score, rel=1e-12)


@given(st.lists(st.tuples(st.sampled_from(range(4)), st.integers(-3, 3)), max_size=40))
def test_every_niche_holds_its_first_maximum(offers: list[tuple[int, int]]) -> None:
    """In any order of arrival a niche ends with the best offered to it, the first of equals; archives are values."""
    archive = Archive()
    for index, (niche, objective) in enumerate(offers):
        before, standing = archive, dict(archive.elites)
        archive, status = insert(archive, niche, elite(str(index), objective))
        assert before.elites == standing
        held = standing.get(niche)
        better = AddStatus.new if held is None else AddStatus.improved
        assert status is (better if held is None or objective > held.objective else AddStatus.rejected)
    for niche in {niche for niche, _ in offers}:
        best = max(objective for where, objective in offers if where == niche)
        first = next(index for index, offer in enumerate(offers) if offer == (niche, best))
        assert archive.elites[niche] == elite(str(first), best)


@given(st.lists(st.tuples(UNIT, UNIT), max_size=30))
def test_niches_of_points_are_those_of_the_nearest_centroids(points: list[tuple[float, float]]) -> None:
    """Asked for all at once, as a rebuilt archive does, or for each, as a newcomer does."""
    niches = QUARTERS.niches_of(points)
    assert niches == [QUARTERS.niche_of(point) for point in points]
    for niche, (x, y) in zip(niches, points, strict=True):
        distances = np.hypot(*(QUARTERS.centroids - [x, y]).T)
        assert distances[niche] == pytest.approx(distances.min(), abs=1e-12)


def test_niches_are_those_of_a_search_tree() -> None:
    """Of a peer, for points inside, on the edges, and at the middle of an axis."""
    centroids = find_centroids(niches=30, dimensions=2, samples=1_000, seed=0)
    points = stream(2, "tree").random((3_000, 2))
    points[1_000:, 0], points[2_000:, 1] = 0.5, 1.0
    assert Tessellation(centroids).niches_of(points.tolist()) == cKDTree(centroids).query(points)[1].tolist()


def test_first_of_equally_near_niches_counts() -> None:
    """Wherever it stands among many, for one point and for many."""
    side = (np.arange(8) + 0.5) / 8
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    corners = [(x, y) for x in range(1, 8) for y in range(1, 8)]
    expected = [8 * (y - 1) + x - 1 for x, y in corners]
    assert Tessellation(grid).niches_of([(x / 8, y / 8) for x, y in corners]) == expected


@pytest.mark.parametrize("point", [(math.nan, 0.5), (math.inf, 0.5), (0.5,)])
def test_point_outside_the_space_is_refused(point: tuple[float, ...]) -> None:
    """A point needs as many finite coordinates as the space has, wherever it stands among others."""
    with pytest.raises(ValueError, match="a point needs 2 finite coordinates"):
        QUARTERS.niches_of([(0.5, 0.5), point])


def test_centroids_are_even_and_repeatable() -> None:
    """The same arguments give the same centroids, inside the cube, and niches of about equal size."""
    shape = {"niches": 16, "dimensions": 2, "samples": 5_000, "seed": 3}
    centroids = find_centroids(**shape)
    assert centroids == find_centroids(**shape)
    assert centroids != find_centroids(**{**shape, "seed": 4})
    tessellation = Tessellation(centroids)
    counts = np.bincount([tessellation.niche_of(point) for point in stream(1, "even").random((8_000, 2))], minlength=16)
    assert tessellation.centroids.min() > 0
    assert tessellation.centroids.max() < 1
    assert counts.min() > 0.5 * counts.mean()
    assert counts.max() < 1.5 * counts.mean()


def test_bounds_clip_and_centre() -> None:
    """Outside is clipped; an axis without extent gives its middle."""
    bounds = AxisBounds(low=(0.0, 5.0), high=(2.0, 5.0))
    assert bounds.normalise((1.0, 5.0)) == (0.5, 0.5)
    assert bounds.normalise((-1.0, 9.0)) == (0.0, 0.5)
    assert bounds.normalise((3.0, 0.0)) == (1.0, 0.5)


def test_fixed_bounds_never_move() -> None:
    """Given bounds clip what lies outside."""
    fixed = NetworkArchive(bounds=AxisBounds(low=(0.0, 0.0), high=(1.0, 1.0)), fixed=True)
    networks, niche, _ = fixed.offer(QUARTERS, individual("a", 1.0, (9.0, -9.0)))
    assert niche == QUARTERS.niche_of((1.0, 0.0))
    assert networks.bounds == fixed.bounds


@given(st.lists(st.tuples(UNIT, UNIT, st.integers(-3, 3)), min_size=1, max_size=25))
def test_grown_archive_equals_one_rebuilt_from_scratch(offers: list[tuple[float, float, int]]) -> None:
    """However the bounds moved on the way, the end is the insertion of all candidates under the last bounds."""
    networks = NetworkArchive()
    for index, (x, y, objective) in enumerate(offers):
        networks, niche, _ = networks.offer(QUARTERS, individual(str(index), objective, (x, y)))
        assert networks.bounds is not None
        assert niche == QUARTERS.niche_of(networks.bounds.normalise((x, y)))
    xs, ys, _ = zip(*offers, strict=True)
    assert networks.bounds == AxisBounds(low=(min(xs), min(ys)), high=(max(xs), max(ys)))
    fresh = Archive()
    for index, (x, y, objective) in enumerate(offers):
        fresh, _ = insert(fresh, QUARTERS.niche_of(networks.bounds.normalise((x, y))), elite(str(index), objective))
    assert networks.archive == fresh


def test_qd_score_sums_quality_exactly() -> None:
    """The sum of 1 / (1 + loss) does not depend on the order of the niches."""
    losses = stream(0, "losses").random(1_000).tolist()
    one, other = Archive(), Archive()
    for niche, (loss, opposite) in enumerate(zip(losses, reversed(losses), strict=True)):
        one, _ = insert(one, niche, elite("", -loss))
        other, _ = insert(other, niche, elite("", -opposite))
    assert qd_score(one) == qd_score(other) == math.fsum(1 / (1 + loss) for loss in losses)


def kept_after(*objectives: float) -> tuple[Archive, list[AddStatus]]:
    """Offer candidates to an archive of two places for the best."""
    networks, said = NetworkArchive(), []
    for index, objective in enumerate(objectives):
        networks, _, status = networks.offer(TopK(niches=2), individual(str(index), objective, (0.5, 0.5)))
        said.append(status)
    assert networks.bounds is None
    return networks.archive, said


@pytest.mark.parametrize(
    ("objectives", "kept", "statuses"),
    [
        ((1, 3, 2, 0), {0: "2", 1: "1"}, ("new", "new", "improved", "rejected")),  # the least fit has to go
        ((1, 1, 0), {0: "0", 1: "2"}, ("new", "rejected", "new")),  # equal fitness takes no second place
    ],
)
def test_places_fill_first_and_then_go_to_the_strictly_fitter(
    objectives: tuple[float, ...], kept: dict[int, str], statuses: tuple[str, ...]
) -> None:
    """Wherever the candidates lie."""
    archive, said = kept_after(*objectives)
    assert {place: elite.name for place, elite in archive.elites.items()} == kept
    assert tuple(said) == statuses


@given(st.lists(st.integers(-5, 5), min_size=1, max_size=25))
def test_places_hold_the_best_distinct_objectives(objectives: list[int]) -> None:
    """In any order of arrival, what is kept are the two highest objectives, each from the first that had it."""
    archive, _ = kept_after(*objectives)
    best = sorted(set(objectives), reverse=True)[:2]
    assert sorted((kept.objective for kept in archive.elites.values()), reverse=True) == best


def test_place_of_nan_is_refused() -> None:
    """A newcomer that can be compared with nothing is refused, by places as by niches: `insert` decides in both."""
    with pytest.raises(ValueError, match="the objective of 1 must be a number; got nan"):
        kept_after(1, math.nan)


@given(st.lists(st.tuples(UNIT, UNIT, st.integers(-3, 3)), min_size=1, max_size=25))
def test_old_network_archives_stay_what_they_were(offers: list[tuple[float, float, int]]) -> None:
    """Each remembers the candidates offered to it, also when later ones moved the bounds."""
    states = [NetworkArchive()]
    for index, (x, y, objective) in enumerate(offers):
        networks, _, _ = states[-1].offer(QUARTERS, individual(str(index), objective, (x, y)))
        states.append(networks)
    expected = [individual(str(index), objective, (x, y)) for index, (x, y, objective) in enumerate(offers)]
    for count, state in enumerate(states):
        assert list(state.history.values()) == expected[:count]
    branch, _, _ = states[1].offer(QUARTERS, individual("other", 0, (0.5, 0.5)))
    assert list(branch.history) == ["0", "other"]
    assert list(states[-1].history) == [str(index) for index in range(len(offers))]
