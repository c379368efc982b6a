"""Promise: all runs of a sweep are measured in one archive, which is pyribs' on the same candidates."""

from dataclasses import replace

import numpy as np
import pytest
from hand_runs import altered, bounds_of, closed, configured, rejected, run, trained
from hand_sweeps import run_of, run_to
from ribs.archives import CVTArchive

from analysis.sweeps.common_archive import CommonArchive, common_archive, extents, filled
from tacevo.choices import Scale
from tacevo.evolution.archive import find_centroids
from tacevo.randomness import stream
from tacevo.results.run import RecordedRun, descriptors_of

#: A left and a right niche.
HALVES = np.array([[0.25, 0.5], [0.75, 0.5]])


def with_archive(one: RecordedRun, **archive: object) -> RecordedRun:
    """Return a run other settings of its archive."""
    return replace(one, config=configured(archive=archive))


def reference(*others: RecordedRun, **archive: object) -> CommonArchive:
    """Make the common archive of runs, the first of which is the reference."""
    first = with_archive(others[0], **archive)
    return common_archive([first, *others[1:]], first, HALVES)


def test_two_hundred_candidates_agree_with_pyribs() -> None:
    """After every generation: the coverage and QD-score of its CVTArchive, which knows these bounds from the start."""
    rng = stream(0, "common archive")
    centroids = np.array(find_centroids(niches=30, dimensions=2, samples=1_000, seed=0))
    candidates = [
        trained(number // 20, number % 20, float(loss), descriptors=(float(x), float(y)))
        for number, (loss, x, y) in enumerate(rng.random((200, 3)) * (1, 5, 40))
    ]
    one = with_archive(run_of(candidates))
    common = common_archive([one], one, centroids)
    points = np.array([descriptors_of(candidate, Scale.linear) for candidate in candidates])
    places = (points - points.min(axis=0)) / np.ptp(points, axis=0)
    qualities = [1 / (1 + candidate.fitness) for candidate in candidates if candidate.fitness is not None]
    peer = CVTArchive(solution_dim=1, centroids=centroids, ranges=[(0, 1), (0, 1)])
    theirs = []
    for first in range(0, 200, 20):
        peer.add([[0.0]] * 20, qualities[first : first + 20], places[first : first + 20])
        theirs += [float(peer.stats.coverage), float(peer.stats.qd_score)]
    ours = filled(one, common)[["coverage", "qd_score"]].to_numpy().ravel().tolist()
    assert ours == pytest.approx(theirs, rel=1e-8)


def test_bounds_are_those_of_all_runs() -> None:
    """Alone, a run's own extremes fill both halves; beside a run that went further, it stayed in one."""
    near = run_to(0.5, 0.5, descriptors=[(0.0, 1.0), (0.1, 1.0)])
    far = run_to(0.5, 0.5, descriptors=[(0.0, 1.0), (1.0, 1.0)])
    assert filled(near, reference(near)).coverage.iloc[-1] == 1.0
    assert filled(near, reference(near, far)).coverage.iloc[-1] == 0.5
    assert filled(far, reference(near, far)).coverage.iloc[-1] == 1.0


def test_what_was_rejected_fills_no_niche() -> None:
    """A generation without a trained candidate leaves the archive as it was."""
    one = run([trained(0, 0, 0.5), rejected(1, 0)], [closed(0), closed(1, trained=0)])
    frame = filled(one, reference(one))
    assert frame.loc[0].equals(frame.loc[1])
    assert frame.coverage.tolist() == [0.5, 0.5]


def test_fixed_bounds_of_the_reference_are_common() -> None:
    """They measured its own search, too; what lies outside is clipped."""
    one = altered(run_to(0.5, 0.5, descriptors=[(0.0, 1.0), (0.1, 1.0)]), bounds=bounds_of((0.0, 0.2), (0.0, 1.0)))
    assert reference(one, bounds="fixed").bounds.high == (0.2, 1.0)
    assert reference(one).bounds.high == (0.1, 1.0)


def test_scale_is_that_of_the_reference() -> None:
    """Ratios of 1 and 100 are 0 and 2 on its logarithmic axis."""
    one = run_to(0.5, 0.5, descriptors=[(0.0, 1.0), (0.1, 100.0)])
    common = reference(one, eff_ratio_scale="log")
    assert (common.scale, common.bounds.low[1], common.bounds.high[1]) == (Scale.log, 0.0, 2.0)


def test_outlier_that_decides_the_bounds_is_named() -> None:
    """One efficiency ratio of 100 leaves 9 of 10 candidates in the first tenth of the axis."""
    crowd = run_to(*[0.5] * 9, descriptors=[(number / 9, 1.0) for number in range(9)])
    outlier = altered(run_to(0.5, descriptors=[(1.0, 100.0)]), name="far")
    diversity, ratio = extents([crowd, outlier], reference(crowd, outlier)).itertuples()
    assert (ratio.low, ratio.high, len(ratio.lowest), ratio.highest) == (1.0, 100.0, 9, ("far/g00s00",))
    assert (ratio.fullest, diversity.fullest) == (0.9, 0.1)


def test_fixed_bounds_are_no_candidates() -> None:
    """They were set before any was there."""
    one = run_to(0.5, 0.5, descriptors=[(0.0, 0.0), (1.0, 1.0)])
    assert {(row.lowest, row.highest) for row in extents([one], reference(one, bounds="fixed")).itertuples()} == {
        ((), ())
    }
