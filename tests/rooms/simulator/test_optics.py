"""The simulated camera: an equidistant fisheye over a dome, and the detail that blur and pixels leave."""

import math

import numpy as np
import pytest

from tacevo.data.simulator.optics import DOME_RADIUS, LENS_DISTANCE, pixels_per_radian, project, seen_points, transfer


@pytest.mark.parametrize("size", [16, 33, 256])
def test_what_a_pixel_sees_appears_at_that_pixel(size: int) -> None:
    """Following a ray to the dome and projecting that point back are inverse to each other."""
    x, y = seen_points(size)
    seen = x * x + y * y < 19.0**2
    columns, rows = project(x[seen], y[seen], np.zeros(seen.sum()), size)
    row, column = np.nonzero(seen)
    assert columns == pytest.approx(column, abs=1e-4)
    assert rows == pytest.approx(row, abs=1e-4)


def test_fisheye_is_equidistant() -> None:
    """A point seen at an angle lies f times that angle from the middle: here 45 degrees, at 256 pixels."""
    along = 15.0
    lift = LENS_DISTANCE - DOME_RADIUS + math.sqrt(DOME_RADIUS**2 - along**2) - along  # as high as it is far out
    columns, rows = project(np.array([along]), np.array([0.0]), np.array([lift]), 256)
    assert columns[0] - 127.5 == pytest.approx(128 * math.pi / 4, abs=1e-4)
    assert rows[0] == pytest.approx(127.5)


def test_lifted_points_move_outwards() -> None:
    """What comes nearer to the lens is seen at a wider angle; on the axis it stays where it is."""
    x, lift = np.array([0.0, 5.0, 5.0]), np.array([2.0, 0.0, 2.0])
    columns, _ = project(x, np.zeros(3), lift, 256)
    assert columns[0] == pytest.approx(127.5)
    assert columns[2] > columns[1] + 1


def test_resolution_at_the_middle_is_that_of_the_real_sensor() -> None:
    """6.7 pixels a millimetre at 256 pixels (measured on photographs)."""
    assert pixels_per_radian(256) / LENS_DISTANCE == pytest.approx(6.7, abs=0.05)


def test_fine_patterns_fade_and_coarse_ones_stay() -> None:
    """Transfer is the product of the blur's Gaussian and the pixel's sinc; at 64 pixels 0.5 mm is all but gone."""
    pixel = 19 / 128
    by_hand = math.exp(-2 * math.pi**2 * 0.14**2) * np.sinc(pixel)
    assert transfer(1.0, 256) == pytest.approx(by_hand, abs=1e-5)
    assert transfer(8.0, 256) > 0.97
    assert transfer(0.5, 256) < 0.25
    assert transfer(0.5, 64) < 0.05
    periods = [transfer(period, 256) for period in (0.4, 0.6, 1.0, 2.0, 4.0)]
    assert periods == sorted(periods)
