"""Promise: the cells drawn for an archive are its niches, all of them, and those that the run was searched with."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from refusals import refused

from analysis.runs.niches import Polygon, cells, load_niches
from tacevo.errors import RunError, StoreError
from tacevo.evolution.archive import Tessellation, find_centroids
from tacevo.results.run import read_run


def area(polygon: Polygon) -> float:
    """Measure a polygon by the shoelace formula; positive where its corners go round anticlockwise."""
    x, y = polygon.T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)


def holds(polygon: Polygon, point: NDArray[np.float64]) -> bool:
    """Return whether a point lies inside a convex polygon whose corners go round anticlockwise."""
    along, towards = np.roll(polygon, -1, axis=0) - polygon, point - polygon
    return bool((along[:, 0] * towards[:, 1] - along[:, 1] * towards[:, 0] > -1e-12).all())


@pytest.mark.parametrize("niches", [1, 2, 3, 5, 40])
def test_cells_cover_the_square_once(niches: int) -> None:
    """There are as many cells as niches, none leaves the square, and their areas add up to its own."""
    drawn = cells(np.array(find_centroids(niches=niches, dimensions=2, samples=500, seed=3)))
    assert len(drawn) == niches
    assert all(area(polygon) > 0 and polygon.min() >= 0 and polygon.max() <= 1 for polygon in drawn)
    assert sum(map(area, drawn)) == pytest.approx(1.0, abs=1e-12)


def test_cell_holds_what_its_niche_holds() -> None:
    """Random points lie in the cell of the very niche that the archive puts them into."""
    centroids = np.array(find_centroids(niches=30, dimensions=2, samples=500, seed=0))
    drawn, niches = cells(centroids), Tessellation(centroids)
    for point in np.random.default_rng(0).random((300, 2)):
        assert holds(drawn[niches.niche_of(point)], point)


def test_two_niches_meet_half_way() -> None:
    """By hand: points at a quarter and three quarters share the square in halves."""
    left, right = cells(np.array([[0.25, 0.5], [0.75, 0.5]]))
    assert sorted(left.round(12).tolist()) == [[0, 0], [0, 1], [0.5, 0], [0.5, 1]]
    assert sorted(right.round(12).tolist()) == [[0.5, 0], [0.5, 1], [1, 0], [1, 1]]


def test_niches_are_those_of_the_archive_files(published: Path) -> None:
    """Every centroid that archive.json names is the one of its niche."""
    niches = load_niches(read_run(published / "run"))
    elites = json.loads((published / "run" / "archive.json").read_text())["elites"]
    assert elites
    assert [niches.networks[elite["niche"]].tolist() for elite in elites] == [elite["centroid"] for elite in elites]
    assert niches.prompts.shape == (5, 2)


def test_lost_centroids_are_computed_and_checked(published: Path, tmp_path: Path) -> None:
    """Without a store the same niches come, and others are never taken for the run's."""
    shutil.copytree(published / "run", tmp_path / "run")
    run = read_run(tmp_path / "run")
    alone, stored = load_niches(run.with_store(str(tmp_path / "nothing"))), load_niches(run)
    assert (alone.networks == stored.networks).all()
    other = replace(run.config, archive=replace(run.config.archive, seed=99))
    moved = replace(run, config=other).with_store(str(tmp_path / "nothing"))
    with refused(RunError, expected="the niches that", remedy="--store"):
        load_niches(moved)


def test_damaged_centroids_are_told(published: Path, tmp_path: Path) -> None:
    """A broken entry is not a reason to compute silently."""
    shutil.copytree(published / "cache" / "centroids", tmp_path / "centroids")
    for path in (tmp_path / "centroids").rglob("*.json"):
        path.write_text("{}")
    with refused(StoreError, expected="a value"):
        load_niches(read_run(published / "run", str(tmp_path)))


def test_niches_that_would_take_hours_are_asked_for(published: Path, tmp_path: Path) -> None:
    """A record can name a billion of them; where no store has them, they are not computed."""
    run = read_run(published / "run")
    huge = replace(run, config=replace(run.config, archive=replace(run.config.archive, niches=10**9)))
    with refused(RunError, place=str(tmp_path), expected="the centroids of 1000000000 niches"):
        load_niches(huge.with_store(str(tmp_path)))
