"""The camera of a see-through tactile sensor: where a pixel looks, where a marker appears, what detail is lost.

A fisheye camera on the sensor's axis looks from inside at a dome. The figures are those published with a ViTacTip's
digital twin (github piotr-blaszyk/shallow-vessel-palpation-simulator-and-AI, MIT licence): an equidistant lens,
r = f theta. Lengths in mm on the undeformed skin, seen along the axis; image lengths in pixels of the image at hand.
"""

import math

import numpy as np

from tacevo.data.simulator.portable import Field, arctan, cosine, exp_minus, sine

REFERENCE_SIZE = 256

#: Pixels per radian at the reference size.
FOCAL = 128.0

#: Lens to the top of the dome, and the dome's radius of curvature.
LENS_DISTANCE, DOME_RADIUS = 19.0, 38.0

#: Standard deviation of the optical blur of skin and gel; between the 0.1 and 0.2 mm that such layers have.
BLUR = 0.14

#: Rays further from the axis than this, in radians, meet no skin.
WIDEST_ANGLE = 1.4


def pixels_per_radian(size: int) -> float:
    """Scale the lens to an image size."""
    return FOCAL * size / REFERENCE_SIZE


def seen_points(size: int) -> tuple[Field, Field]:
    """Follow each pixel's ray to the dome: the intersection with a sphere that lies before the lens.

    Returns:
        x and y of the points, float64, shape (size, size).
    """
    offsets = np.arange(size) - (size - 1) / 2
    column, row = np.meshgrid(offsets, offsets)
    reach = np.maximum(np.sqrt(column * column + row * row), 1e-6)  # an odd size has a pixel at the centre
    turns = np.minimum(reach / pixels_per_radian(size), WIDEST_ANGLE) / (2 * math.pi)
    centre = LENS_DISTANCE - DOME_RADIUS
    across, along = centre * sine(turns), centre * cosine(turns)
    rho = (along + np.sqrt(DOME_RADIUS * DOME_RADIUS - across * across)) * sine(turns)
    return column / reach * rho, row / reach * rho


def project(x: Field, y: Field, lift: Field, size: int) -> tuple[Field, Field]:
    """Find the columns and rows at which points of the dome appear that are lifted towards the camera by `lift`."""
    squared = x * x + y * y
    rho = np.maximum(np.sqrt(squared), 1e-9)
    depth = LENS_DISTANCE - DOME_RADIUS + np.sqrt(DOME_RADIUS * DOME_RADIUS - squared) - lift
    outwards = pixels_per_radian(size) * arctan(rho / depth) / rho
    middle = (size - 1) / 2
    return x * outwards + middle, y * outwards + middle


def transfer(period: float, size: int, blur: float = BLUR) -> float:
    """Find the share of a pattern's contrast that reaches the image at the dome's centre.

    Gaussian blur passes exp(-2 pi^2 s^2 / l^2) of a period l, and averaging over a pixel of width p the modulus of
    sin(pi p / l) / (pi p / l) (the Fourier transforms of both spread functions; Goodman,
    Introduction to Fourier Optics, chapter 6).
    """
    ratio = blur / period
    cycles = LENS_DISTANCE / pixels_per_radian(size) / period
    averaged = abs(float(sine(cycles / 2))) / (math.pi * cycles)
    return float(exp_minus(2 * math.pi * math.pi * ratio * ratio)) * averaged
