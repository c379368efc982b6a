"""The picture of a see-through tactile sensor (ViTacTip-like): what its camera sees of one press.

A soft dome carries 127 dark markers on a hexagonal grid and lets the camera see what touches it. Brightness, marker
size and pitch follow photographs of a real ViTacTip (`tacevo.data.simulator.optics` has the source). Lengths in mm on
the undeformed skin, seen along the camera's axis; grey values 0 to 255; image lengths in pixels of a 256 pixel image,
scaled to the size asked for. Pixels are float32 and their arithmetic is that of `tacevo.data.simulator.portable`, so
that a picture has the same bytes on every CPU.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from tacevo.choices import LightScene, SimulatedSensor
from tacevo.data.simulator.contact import imprint_at_depth, normal_field, shear_field, spread_radius
from tacevo.data.simulator.optics import BLUR, REFERENCE_SIZE, project, seen_points, transfer
from tacevo.data.simulator.portable import Field, cosine, exp_minus, grain, normal, normal_number, sine, step
from tacevo.parts.source import Picture
from tacevo.randomness import stream

#: Radius of the dome's rim, where the skin is held, and of what is in sight of it.
RIM_RADIUS, SIGHT_RADIUS = 20.0, 19.7

MARKER_RINGS, MARKER_PITCH, MARKER_PIXELS = 6, 2.0, 2.75

#: Width of a marker's soft edge, in pixels of the image at hand.
EDGE = 0.45

#: Length of the pins that carry the markers; a slope of the skin tilts them.
PIN_LENGTH = 1.6

SKIN_THICKNESS = 1.0

SKIN_POISSON = 0.49

#: Grey values per unit slope of the skin towards the light.
SHADING = 60.0

#: Real images saturate below white.
BRIGHTEST = 250.0

#: Gain of the light and its tilt to one side, over the dome's radius, of each scene.
SCENES = {
    LightScene.standard: (1.0, 0.0),
    LightScene.dim: (0.7, 0.0),
    LightScene.bright: (1.25, 0.0),
    LightScene.side: (1.0, 0.3),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Grating:
    """A square plate of straight ridges and grooves of equal width, pressed onto the sensor."""

    #: Width of a ridge and a groove together.
    period: float
    #: Unit vector across the ridges, and the place of the first ridge, in periods.
    across: tuple[float, float]
    phase: float
    #: Light of a groove's bottom, that of a ridge being 1, and below 0 where it is darker than no contact; amplitude of
    #: the imprint in the skin's outside; side of the plate.
    groove: float
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
    #: Sideways displacement (x, y) of the skin at which the whole contact slides, and the radius that still sticks.
    slip_limit: tuple[float, float]
    stick_radius: float
    #: Displacement (x, y) by which the dome as a whole gives way to the sideways force, at its middle.
    lean: tuple[float, float]
    #: Grey values that a touching object adds, and the gap at which it has faded to 1/e.
    brightness: float
    fading: float
    grating: Grating | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensor:
    """One sensor at one image size: float32 arrays of shape (size, size), and markers, float64, of shape (127,)."""

    size: int
    #: The point of the undeformed skin, in mm, at which each pixel looks.
    x: npt.NDArray[np.float32]
    y: npt.NDArray[np.float32]
    #: Grey values without contact; dirt, of unit size; 1 where the dome is in sight and 0 outside.
    background: npt.NDArray[np.float32]
    dirt: npt.NDArray[np.float32]
    sight: npt.NDArray[np.float32]
    marker_x: npt.NDArray[np.float64]
    marker_y: npt.NDArray[np.float64]
    #: Thickness of the clear gel on its skin, of the skin's own material.
    gel: float = 0.0

    @property
    def blur(self) -> float:
        """Standard deviation of the optical blur: light that is scattered forwards spreads in proportion to its way."""
        return BLUR * (1 + self.gel / SKIN_THICKNESS)


@lru_cache(maxsize=4)
def make_sensor(size: int, seed: int, gel: float = 0.0) -> Sensor:
    """Build the sensor; its seed decides manufacturing errors of the markers and the dirt on its skin."""
    x, y = seen_points(size)
    squared = x * x + y * y
    sight = step((SIGHT_RADIUS - np.sqrt(squared)) / 0.2)
    rng = stream(seed, "sensor")
    marker_x, marker_y = _marker_grid() + normal(rng, 0.05, (2, 127))
    fields = {
        "x": x,
        "y": y,
        "background": (80 + 107 * exp_minus(squared / 13**2)) * sight,
        "dirt": _dirt(x, y, rng) * sight,
        "sight": sight,
    }
    single = {name: field.astype(np.float32) for name, field in fields.items()}
    return Sensor(size=size, marker_x=marker_x, marker_y=marker_y, gel=gel, **single)


def picture(
    sensor: Sensor,
    press: Press,
    rng: np.random.Generator,
    scene: LightScene,
    kind: SimulatedSensor = SimulatedSensor.ViTacTip,
) -> Picture:
    """Draw what the camera of a kind of sensor sees of one press.

    Light, tint, dirt, camera position and grain vary from image to image and are drawn from `rng`.

    Returns:
        uint8, shape (3, size, size).
    """
    gain, side = SCENES[scene]
    gain *= normal_number(rng, 1, 0.03)
    tilt_x, tilt_y = side + normal_number(rng, 0, 0.03), normal_number(rng, 0, 0.03)  # over the rim's radius
    light = normal_number(rng, 0.6, 0.05), normal_number(rng, 0.3, 0.05)  # the direction that shades a slope
    wear = 6 * rng.uniform(0, 1.2)
    darkness = normal_number(rng, 0.66, 0.02)  # the share of the light that a marker takes
    noise = rng.uniform(2, 5)  # at the reference size; larger pixels average more out
    tint = np.array([1.01, 1.0, normal_number(rng, 0.97, 0.01)], dtype=np.float32)
    grey = sensor.background * (1 + sensor.x * (tilt_x / RIM_RADIUS) + sensor.y * (tilt_y / RIM_RADIUS))
    grey *= gain
    grey += sensor.dirt * wear
    if kind is not SimulatedSensor.TacTip:  # whose skin is opaque, and bends behind its markers
        grey += sensor.sight * _contact_light(sensor, press, light)
    if kind is not SimulatedSensor.ViTac:
        grey *= 1 - darkness * _marker_cover(sensor, press, rng)
    grey += noise * sensor.size / REFERENCE_SIZE * grain(rng, sensor.size)
    coloured: Field = np.clip(tint[:, None, None] * grey, 0, BRIGHTEST)
    return np.rint(coloured).astype(np.uint8)


def _marker_grid() -> npt.NDArray[np.float64]:
    """Place the markers of a hexagon with 6 rings; shape (2, 127)."""
    steps = range(-MARKER_RINGS, MARKER_RINGS + 1)
    cells = [(i, j) for i in steps for j in steps if abs(i + j) <= MARKER_RINGS]
    i, j = np.array(cells, dtype=np.float64).T
    return MARKER_PITCH * np.stack([i + j / 2, j * (math.sqrt(3) / 2)])


def _dirt(x: Field, y: Field, rng: np.random.Generator) -> Field:
    """Scatter 40 smooth spots and scratches of either sign; it looks the same at every image size."""
    total = np.zeros_like(x)
    for _ in range(40):
        right, down = rng.uniform(-RIM_RADIUS, RIM_RADIUS, 2)
        width, length = rng.uniform(0.3, 2.5, 2)
        u, v = (x - right) / width, (y - down) / length
        total += rng.choice([-1.0, 1.0]) * exp_minus(u * u + v * v)
    return total


def _contact_light(sensor: Sensor, press: Press, light: tuple[float, float]) -> Field:
    """Light that a contact adds: shading of the bent skin, and the object seen through it."""
    x, y = sensor.x - press.x, sensor.y - press.y
    squared = x * x + y * y
    _, (slope_x, slope_y) = _bent_skin(_below_gel(press, sensor.gel), sensor.x, sensor.y)
    shading = SHADING * (light[0] * slope_x + light[1] * slope_y)
    gap = np.maximum(squared - press.contact_radius * press.contact_radius, 0) * (0.5 / press.radius)
    nearness = exp_minus(gap * (1 / _blurred_fading(press, sensor.blur)))
    if press.grating is None:
        return shading + press.brightness * nearness
    plate, wave = _plate(press.grating, x, y), _ridges(press.grating, x, y, sensor)
    towards_light = light[0] * press.grating.across[0] + light[1] * press.grating.across[1]
    bent = SHADING * towards_light * _imprint_slope(press.grating, x, y, sensor.gel)
    return shading + nearness * plate * (press.brightness * wave + bent)


def _below_gel(press: Press, gel: float) -> Press:
    """Spread a press over the skin below a layer of gel: the same forces on a larger contact."""
    if gel == 0:
        return press
    wider = spread_radius(press.contact_radius, gel) / press.contact_radius
    return replace(
        press,
        contact_radius=press.contact_radius * wider,
        radius=press.radius * wider * wider * wider,  # F = 4/3 E* a^3 / R stays
        slip_limit=(press.slip_limit[0] / wider, press.slip_limit[1] / wider),  # of a wider contact of the same force
        stick_radius=press.stick_radius * wider,
    )


def _blurred_fading(press: Press, blur: float) -> float:
    """Find the gap at which a touching object has faded to 1/e, as the gel's part of the blur lengthens it.

    Beside the contact the gap widens by a / R for each mm; two lengths of fading add as their squares do.
    """
    if blur == BLUR:
        return press.fading
    added = math.sqrt(blur * blur - BLUR * BLUR) * press.contact_radius / press.radius
    return math.sqrt(press.fading * press.fading + added * added)


def _bent_skin(press: Press, x: Field, y: Field) -> tuple[Field, tuple[Field, Field]]:
    """Find the skin's displacement towards the camera at points of the sensor, and its gradient (x, y)."""
    right, down = x - press.x, y - press.y
    distance = np.maximum(np.sqrt(right * right + down * down), 1e-6)
    displacement, slope = normal_field(distance, press.contact_radius, press.radius)
    clamp = _clamp(x, y)
    inwards = press.share * displacement * (clamp > 0) * (-2 / RIM_RADIUS**2)  # the clamp's gradient, along (x, y)
    steep = press.share * slope * clamp
    return press.share * displacement * clamp, (steep * right + inwards * x, steep * down + inwards * y)


def _plate(grating: Grating, x: Field, y: Field) -> Field:
    """Draw a grating's plate: 1 where it is, 0 elsewhere."""
    cosine_of, sine_of = grating.across
    along = np.abs(y * cosine_of - x * sine_of)
    across = np.abs(x * cosine_of + y * sine_of)
    return step((grating.side / 2 - np.maximum(across, along)) * (1 / 0.12))


def _ridges(grating: Grating, x: Field, y: Field, sensor: Sensor) -> Field:
    """Draw a grating's brightness, 1 on a ridge: a square wave's first two harmonics after blur and pixel averaging."""
    first = cosine(_periods(grating, x, y))
    third = first * (4 * first * first - 3)  # cos 3t from cos t
    passed = (transfer(grating.period / odd, sensor.size, sensor.blur) for odd in (1, 3))
    first_part, third_part = (2 / math.pi * part / odd for part, odd in zip(passed, (1, 3), strict=True))
    wave = 0.5 + first_part * first - third_part * third
    return grating.groove + (1 - grating.groove) * wave


def _imprint_slope(grating: Grating, x: Field, y: Field, gel: float) -> Field:
    """Slope across the ridges of the imprint as it arrives at the skin's inside, where markers and light are."""
    height = grating.imprint * imprint_at_depth(grating.period, SKIN_THICKNESS + gel)
    return (-2 * math.pi / grating.period * height) * sine(_periods(grating, x, y))


def _periods(grating: Grating, x: Field, y: Field) -> Field:
    """Position across the ridges, in periods; whole numbers are the middles of ridges."""
    return (x * grating.across[0] + y * grating.across[1]) * (1 / grating.period) + grating.phase


def _marker_cover(sensor: Sensor, press: Press, rng: np.random.Generator) -> npt.NDArray[np.float32]:
    """The part of each pixel that a marker covers, in [0, 1]."""
    scale = sensor.size / REFERENCE_SIZE
    columns, rows, lift = _marker_pixels(sensor, press)
    shift = normal(rng, 0.25 * scale, (2, 1)) + normal(rng, 0.12 * scale, (2, len(lift)))
    centres = np.stack([columns, rows]) + shift
    reach = math.ceil(MARKER_PIXELS * scale) + 3
    window = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2)).reshape(2, 1, -1)
    pixels = np.rint(centres).astype(np.int64)[:, :, None] + window
    right, down = (pixels - centres[:, :, None]).astype(np.float32)
    radius = (MARKER_PIXELS * scale * (1 + 0.03 * lift)).astype(np.float32)
    cover = step((radius[:, None] - np.sqrt(right * right + down * down)) * (1 / EDGE))
    cover *= _thinning(sensor.size)
    column, row = np.clip(pixels, 0, sensor.size - 1)  # markers never reach the border, so nothing smears there
    total = np.zeros((sensor.size, sensor.size), dtype=np.float32)
    np.add.at(total, (row, column), cover)
    return np.minimum(total, 1)


@lru_cache(maxsize=4)
def _thinning(size: int) -> float:
    """Find how much larger a marker's circle is than its soft disc at an image size, as a ratio of areas below 1.

    A disc with a soft edge covers more than its circle, the more the smaller it is. With this factor a small picture
    has as much of each marker as a large one that is averaged down.
    """
    radius, width = MARKER_PIXELS * size / REFERENCE_SIZE, 1e-3
    distance = (np.arange(20_000) + 0.5) * width
    rings = distance * step((radius - distance) / EDGE)
    return radius * radius / (2 * width * float(np.cumsum(rings)[-1]))  # added one by one: a sum's order may differ


def _marker_pixels(sensor: Sensor, press: Press) -> tuple[Field, Field, Field]:
    """Find column, row and lift (mm towards the camera) of every marker: shear, lean, pin tilt, then perspective."""
    x, y = sensor.marker_x - press.x, sensor.marker_y - press.y
    clamp = _clamp(sensor.marker_x, sensor.marker_y)
    skin = _below_gel(press, sensor.gel)
    lift, (slope_x, slope_y) = _bent_skin(skin, sensor.marker_x, sensor.marker_y)
    shear_x, shear_y = shear_field(
        x, y, skin.contact_radius, stick=skin.stick_radius, limit=skin.slip_limit, poisson=SKIN_POISSON
    )
    if press.grating is not None:
        across = press.grating.across
        pressed = _plate(press.grating, x, y) * (x * x + y * y < press.contact_radius * press.contact_radius)
        ridge = _imprint_slope(press.grating, x, y, sensor.gel) * pressed
        slope_x, slope_y = slope_x + ridge * across[0], slope_y + ridge * across[1]
    # A pin tilts with the skin it stands on, so its tip moves down the slope: outwards around a contact.
    lean_x, lean_y = press.lean
    moved_x = sensor.marker_x + clamp * (shear_x + lean_x) - PIN_LENGTH * slope_x
    moved_y = sensor.marker_y + clamp * (shear_y + lean_y) - PIN_LENGTH * slope_y
    columns, rows = project(moved_x, moved_y, lift, sensor.size)
    return columns, rows, lift


def _clamp(x: Field, y: Field) -> Field:
    """Share of a half-space's displacement that the rim's mounting allows: 1 at the centre, 0 at the rim."""
    return np.maximum(1 - (x * x + y * y) * (1 / RIM_RADIUS**2), 0.0)
