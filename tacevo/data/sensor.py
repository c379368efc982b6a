"""The picture of a see-through tactile sensor (ViTacTip-like): what its camera sees of one press.

A fisheye camera looks from inside at a soft dome with 127 dark markers on a hexagonal grid. Geometry and grey
levels follow photographs of a real ViTacTip (github piotr-blaszyk/shallow-vessel-palpation-simulator-and-AI,
MIT licence): marker pitch, lens, dome and radial brightness. Lengths in mm on the undeformed skin, seen from the
camera's axis; grey values 0 to 255; image lengths in pixels of a 256 pixel image, scaled to the size asked for.

All arithmetic is float64: pixels are rounded to whole numbers at the end, and last-bit differences between CPUs
practically never survive that.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tacevo.data.contact import Field, imprint_at_depth, normal_field, shear_field
from tacevo.data.source import Picture
from tacevo.randomness import stream

REFERENCE_SIZE = 256
#: Equidistant fisheye: pixels from the centre = FOCAL * angle in radians, at the reference size.
FOCAL = 128.0
#: Lens to the top of the dome, the dome's radius of curvature, and the radius of its rim; how much of it is in sight.
LENS_DISTANCE, DOME_RADIUS, RIM_RADIUS, SIGHT_RADIUS = 19.0, 38.0, 20.0, 19.0
MARKER_RINGS, MARKER_PITCH, MARKER_PIXELS = 6, 1.97, 3.05
#: Length of the pins that carry the markers; a slope of the skin tilts them.
PIN_LENGTH = 1.6
SKIN_THICKNESS = 1.0
SKIN_POISSON = 0.49
#: Standard deviation of the optical blur of skin and gel.
BLUR = 0.14
#: Grey values per unit slope of the skin towards the light.
SHADING = 60.0
#: Real images saturate below white.
BRIGHTEST = 250.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Grating:
    """A square plate of straight ridges and grooves of equal width, pressed onto the sensor."""

    period: float
    #: Direction of the ridges and place of the first one, in radians.
    yaw: float
    phase: float
    #: How dark a groove is, in [0, 1]; the height of the imprint in the skin; side of the plate.
    contrast: float
    imprint: float
    side: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Press:
    """The mechanical state of one contact."""

    #: Centre, and radius of the contact area.
    x: float
    y: float
    contact_radius: float
    #: Radius of the combined surfaces, and the skin's share in [0, 1] of the approach.
    radius: float
    share: float
    #: Sideways displacement (x, y) of the skin.
    shear: tuple[float, float]
    #: Grey values that a touching object adds, and the gap at which it has faded to 1/e.
    brightness: float
    fading: float
    grating: Grating | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensor:
    """One sensor at one image size: arrays of shape (size, size), and markers of shape (127,)."""

    size: int
    #: Where each pixel looks at the undeformed skin.
    x: Field
    y: Field
    #: Grey values without contact; dirt, of unit size; 1 where the dome is in sight and 0 outside.
    background: Field
    dirt: Field
    sight: Field
    marker_x: Field
    marker_y: Field


@lru_cache(maxsize=4)
def make_sensor(size: int, seed: int) -> Sensor:
    """Build the sensor; its seed decides manufacturing errors of the markers and the dirt on its skin."""
    x, y = _seen_points(size)
    rho = np.hypot(x, y)
    sight = _step((SIGHT_RADIUS - rho) / 0.2)
    rng = stream(seed, "sensor")
    marker_x, marker_y = _marker_grid() + rng.normal(0, 0.05, (2, 127))
    return Sensor(
        size=size,
        x=x,
        y=y,
        background=(92 + 93 * np.exp(-((rho / 10) ** 2))) * sight,
        dirt=_dirt(x, y, rng) * sight,
        sight=sight,
        marker_x=marker_x,
        marker_y=marker_y,
    )


def picture(sensor: Sensor, press: Press, rng: np.random.Generator) -> Picture:
    """Draw what the camera sees of one press.

    Light, tint, dirt, camera position and noise vary from image to image and are drawn from `rng`.

    Returns:
        uint8, shape (3, size, size).
    """
    gain, tilt_x, tilt_y = rng.normal(1, 0.03), rng.normal(0, 0.03), rng.normal(0, 0.03)
    light = (rng.normal(0.6, 0.05), rng.normal(0.3, 0.05))
    wear, darkness, noise = 6 * rng.uniform(0, 1.2), rng.normal(0.63, 0.02), rng.uniform(2, 5)
    tint = np.array([1.01, 1.0, rng.normal(0.97, 0.01)])
    slope_light = 1 + (tilt_x * sensor.x + tilt_y * sensor.y) / RIM_RADIUS
    grey = (
        gain * slope_light * sensor.background
        + wear * sensor.dirt
        + sensor.sight * _contact_light(sensor, press, light)
    )
    grey *= 1 - darkness * _marker_cover(sensor, press, rng)
    grey += noise * rng.standard_normal(grey.shape)
    coloured = np.clip(tint[:, None, None] * grey, 0, BRIGHTEST)
    return np.rint(coloured).astype(np.uint8)


def _seen_points(size: int) -> tuple[Field, Field]:
    """Follow each pixel's ray to the dome: the near intersection of a line and a sphere."""
    offsets = np.arange(size) - (size - 1) / 2
    column, row = np.meshgrid(offsets, offsets)
    reach = np.hypot(column, row)
    angle = np.minimum(reach / _focal(size), 1.4)
    centre = LENS_DISTANCE - DOME_RADIUS
    along = centre * np.cos(angle) + np.sqrt(DOME_RADIUS**2 - (centre * np.sin(angle)) ** 2)
    rho = along * np.sin(angle)
    return column / reach * rho, row / reach * rho  # sizes are even, so no pixel lies at the centre


def _focal(size: int) -> float:
    """Pixels per radian at an image size."""
    return FOCAL * size / REFERENCE_SIZE


def _marker_grid() -> Field:
    """Place the markers of a hexagon with 6 rings; shape (2, 127)."""
    steps = range(-MARKER_RINGS, MARKER_RINGS + 1)
    cells = [(i, j) for i in steps for j in steps if abs(i + j) <= MARKER_RINGS]
    i, j = np.array(cells, dtype=np.float64).T
    return MARKER_PITCH * np.stack([i + j / 2, j * math.sqrt(3) / 2])


def _dirt(x: Field, y: Field, rng: np.random.Generator) -> Field:
    """Scatter 40 smooth spots and scratches of either sign; it looks the same at every image size."""
    total = np.zeros_like(x)
    for _ in range(40):
        across, down = rng.uniform(-RIM_RADIUS, RIM_RADIUS, 2)
        width, length = rng.uniform(0.3, 2.5, 2)
        total += rng.choice([-1.0, 1.0]) * np.exp(-(((x - across) / width) ** 2) - ((y - down) / length) ** 2)
    return total


def _contact_light(sensor: Sensor, press: Press, light: tuple[float, float]) -> Field:
    """Light that a contact adds: shading of the bent skin, and the object seen through it."""
    x, y = sensor.x - press.x, sensor.y - press.y
    squared = x * x + y * y
    distance = np.sqrt(squared) + 1e-9
    _, slope = normal_field(distance, press.contact_radius, press.radius)
    clamped = press.share * slope * _clamp(sensor.x, sensor.y)
    shading = SHADING * clamped * (light[0] * x + light[1] * y) / distance
    gap = np.maximum(squared - press.contact_radius**2, 0) / (2 * press.radius)
    touch = press.brightness * np.exp(-gap / press.fading)
    if press.grating is None:
        return shading + touch
    return shading * 0.5 + touch * _ridges(press.grating, x, y, FOCAL / LENS_DISTANCE * sensor.size / REFERENCE_SIZE)


def _ridges(grating: Grating, x: Field, y: Field, pixels_per_mm: float) -> Field:
    """Brightness of a grating plate, 1 on a ridge: a square wave's first harmonics after blur and pixel averaging.

    The blur's modulation transfer is exp(-2 pi^2 s^2 / l^2) at period l; a wider groove is darker because less light
    leaves it.
    """
    cosine, sine = math.cos(grating.yaw), math.sin(grating.yaw)
    across, along = x * cosine + y * sine, y * cosine - x * sine
    angle = 2 * math.pi / grating.period * across + grating.phase
    wave = np.full_like(x, 0.5)
    for harmonic, sign in ((1, 1), (3, -1)):
        period = grating.period / harmonic
        passed = math.exp(-2 * (math.pi * BLUR / period) ** 2) * abs(np.sinc(1 / (period * pixels_per_mm)))
        wave += sign * 2 / (math.pi * harmonic) * passed * np.cos(harmonic * angle)
    depth = grating.contrast * (1 - math.exp(-grating.period / 1.6))
    imprint = grating.imprint * imprint_at_depth(grating.period, SKIN_THICKNESS) * np.cos(angle)
    plate = _step((grating.side / 2 - np.maximum(np.abs(across), np.abs(along))) / 0.12)
    return plate * (1.5 * (1 - depth + depth * wave) + imprint)


def _marker_cover(sensor: Sensor, press: Press, rng: np.random.Generator) -> Field:
    """How much of each pixel a marker covers, in [0, 1]."""
    scale = sensor.size / REFERENCE_SIZE
    columns, rows, lift = _marker_pixels(sensor, press)
    shift = rng.normal(0, 0.25 * scale, (2, 1)) + rng.normal(0, 0.12 * scale, (2, len(lift)))
    centres = np.stack([columns, rows]) + shift
    reach = math.ceil(MARKER_PIXELS * scale) + 3
    window = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2)).reshape(2, 1, -1)
    pixels = np.rint(centres).astype(np.int64)[:, :, None] + window
    distance = np.hypot(*(pixels - centres[:, :, None]))
    cover = _step((MARKER_PIXELS * scale * (1 + 0.03 * lift[:, None]) - distance) / 0.45)
    column, row = np.clip(pixels, 0, sensor.size - 1)  # markers never reach the border, so nothing smears there
    total = np.zeros((sensor.size, sensor.size))
    np.maximum.at(total, (row, column), cover)
    return total


def _marker_pixels(sensor: Sensor, press: Press) -> tuple[Field, Field, Field]:
    """Find column, row and lift (mm towards the camera) of every marker: shear, pin tilt, then perspective."""
    x, y = sensor.marker_x - press.x, sensor.marker_y - press.y
    distance = np.hypot(x, y) + 1e-9
    clamp = _clamp(sensor.marker_x, sensor.marker_y)
    displacement, slope = normal_field(distance, press.contact_radius, press.radius)
    lift = press.share * displacement * clamp
    tilt = -PIN_LENGTH * press.share * slope * clamp / distance  # pins splay outwards, away from the contact
    shear_x, shear_y = shear_field(x, y, press.contact_radius, press.shear, SKIN_POISSON)
    moved_x = sensor.marker_x + clamp * shear_x + tilt * x
    moved_y = sensor.marker_y + clamp * shear_y + tilt * y
    rho = np.hypot(moved_x, moved_y) + 1e-9
    depth = LENS_DISTANCE - DOME_RADIUS + np.sqrt(DOME_RADIUS**2 - rho**2) - lift
    outwards = _focal(sensor.size) * np.arctan2(rho, depth) / rho
    middle = (sensor.size - 1) / 2
    return moved_x * outwards + middle, moved_y * outwards + middle, lift


def _clamp(x: Field, y: Field) -> Field:
    """Share of a half-space's displacement that the rim's mounting allows: 1 at the centre, 0 at the rim."""
    return np.maximum(1 - (x * x + y * y) / RIM_RADIUS**2, 0.0)


def _step(x: Field) -> Field:
    """Smooth step from 0 to 1 around 0 (logistic)."""
    return 1 / (1 + np.exp(np.clip(-x, -60, 60)))
