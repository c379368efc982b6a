"""Promise: the front is what no point beats, and its hypervolume is the area that its points dominate."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis.statistics.pareto import front, hypervolume

#: Few values, so that points equal each other in one place or in all.
POINTS = st.lists(st.tuples(*[st.integers(0, 5)] * 2), max_size=12)


def test_front_by_hand() -> None:
    """In order of the first objective; a point beaten in one and equal in the other is out, of equal ones the first."""
    points = [(3, 1), (1, 3), (2, 2), (2, 3), (3, 3), (1, 3)]
    assert front(points).tolist() == [1, 2, 0]
    assert front([(1, 1, 2), (1, 1, 1), (2, 0, 1)]).tolist() == [1, 2]


@given(POINTS.filter(bool))
def test_front_is_what_nobody_dominates(points: list[tuple[int, int]]) -> None:
    """As the definition has it, over all pairs."""

    def beats(one: tuple[int, int], other: tuple[int, int]) -> bool:
        return one != other and one[0] <= other[0] and one[1] <= other[1]

    expected = {point for point in points if not any(beats(other, point) for other in points)}
    rows = front(points).tolist()
    assert sorted(points[row] for row in rows) == sorted(expected)
    assert all(row == points.index(points[row]) for row in rows)


def test_hypervolume_by_hand() -> None:
    """Two rectangles that overlap, 2 x 1 and 1 x 2 of a box of 4 x 4 from the corner (4, 4)."""
    assert hypervolume([(2, 3), (3, 2)], (4, 4)) == pytest.approx(3 / 16)
    assert hypervolume([(1, 1)], (2, 4)) == pytest.approx(0.5 * 0.75)


def test_point_outside_the_box_adds_nothing() -> None:
    """One that is not better than the reference in both; no point at all has no volume."""
    assert hypervolume([(4, 0), (0, 4), (9, 0)], (4, 4)) == hypervolume([], (4, 4)) == 0
    assert hypervolume([(0, 0)], (4, 4)) == 1


@given(POINTS, st.tuples(*[st.integers(1, 6)] * 2))
def test_hypervolume_is_that_of_a_brute_force(points: list[tuple[int, int]], reference: tuple[int, int]) -> None:
    """Cut along every coordinate, a cell of the box counts if some point is at most its lower corner in both."""
    across, up = ({0, end, *(min(point[axis], end) for point in points)} for axis, end in enumerate(reference))
    area = sum(
        (right - left) * (top - bottom)
        for left, right in pairwise(sorted(across))
        for bottom, top in pairwise(sorted(up))
        if any(x <= left and y <= bottom for x, y in points)
    )
    assert hypervolume(points, reference) == pytest.approx(area / (reference[0] * reference[1]), abs=1e-8)
