"""The simulated sensor as a source: seeded presses of three tasks with their labels.

Promises: image and label depend on the task, the two seeds, the number of the press (within its class for gratings),
the image size and the light, and on nothing else, so the number of workers and the order of drawing cannot matter;
their bytes are the same on every CPU. What it does not promise: that a network trained here works on a real sensor.
"""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from tacevo.choices import LightScene, SensorTask, SimulatedSensor
from tacevo.data.ideal import WIDTH_ERROR
from tacevo.data.simulator.contact import (
    combined_radius,
    conforming_pressure,
    contact_displacement,
    contact_modulus,
    contact_radius,
    mean_pressure,
    modulus_of_shore,
    normal_force,
    slip_limit,
    stick_radius,
    tangential_force,
)
from tacevo.data.simulator.optics import DOME_RADIUS
from tacevo.data.simulator.portable import cosine, exp_minus, normal, normal_number, sine
from tacevo.data.simulator.sensor import SKIN_POISSON, Grating, Press, make_sensor, picture
from tacevo.parts.making import Given, task_among
from tacevo.parts.source import Catalogue, Picture
from tacevo.randomness import stream
from tacevo.records import Json, Kind
from tacevo.storage.canonical import canonical

#: Names of the outputs.
OUTPUTS = {SensorTask.force: ("Fx", "Fy", "Fz"), SensorTask.hardness: ("shore",)}

#: Changes whenever an image or a label would change; part of the cache key.
SIMULATOR_VERSION = 4

#: Six specimens, Shore A, evenly spaced over the range of the paper's supplement (docs/references.bib).
SHORE_LEVELS = (17.5, 20.0, 22.5, 25.0, 27.5, 30.0)

FRICTION = 0.66

#: Task force: the longest sideways stroke of the ball in mm, of which the contact takes a part and the dome the rest.
STROKE = 3.0

#: The errors of the force sensor: noise in N, and hysteresis as a share of the force.
FORCE_NOISE, HYSTERESIS = 0.02, 0.04

#: Task grating: the standard deviation of the yaw, in radians.
GRATING_YAW = 0.15

#: Task grating: side of the plate, which is wider than any contact, depth of a groove, and width at which its bottom
#: has faded to 1/e, in mm; grey values of the light that a plate keeps out.
PLATE_SIDE, GROOVE_DEPTH, GROOVE_FADING, PLATE_SHADE = 20.0, 0.5, 1.0, 50.0

#: Grey values by which specimens of one hardness differ, as a standard deviation.
SPECIMEN_NOISE = 2.5

#: Effective Young's modulus of the sensor in MPa; for hardness the stiffer of two published calibrations, because
#: a soft sensor takes almost the whole approach on every specimen.
SOFT_SKIN, STIFF_SKIN = 0.14, 0.88

#: Sideways stiffness of the dome as a whole, N/mm. We know of no measurement: slices of the dome that shear over one
#: another give 0.25 for a filling of 15 kPa alone, and 2.4 for the skin's modulus throughout.
DOME_STIFFNESS = 0.5

#: Units of the labels; gratings are classes.
UNITS = {SensorTask.force: ("N", "N", "N"), SensorTask.hardness: ("Shore A",)}


def from_settings(given: Given) -> "Simulated":
    """Make the simulated sensor of the settings of `data`.

    Raises:
        ConfigError: it does not know the task.
    """
    data = given.settings
    return Simulated(
        task=task_among(SensorTask, given),
        images=data["images"] or 0,  # which `check_together` excludes
        image_size=data["image_size"],
        seed=data["seed"],
        spacings_mm=tuple(data["spacings_mm"]),
        sensor_seed=data["sensor_seed"],
        light=data["light"],
        sensor=SimulatedSensor(data["sensor"]),  # which `check_together` has looked at
        gel_mm=data["gel_mm"],
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulated:
    """A simulated data set.

    `force`: three forces in N, from a ball of 4 mm radius pressed 0.15 to 2.6 mm deep and pushed sideways, with
    slip; Fz is negative in compression. `grating`: one class per spacing, class by class, as many images of each (or
    one more of the first ones). `hardness`: the Shore A hardness of a rubber ball, one of six levels.
    """

    task: SensorTask
    #: Number of images.
    images: int
    #: Height and width in pixels, from 16 to 256.
    image_size: int
    #: The seed of the presses and of everything that varies from image to image.
    seed: int
    #: The seed of the sensor: with another one, markers and dirt lie elsewhere.
    sensor_seed: int
    light: LightScene
    #: Widths of a ridge, which is also that of a groove, in mm: one class each; used by `grating` only.
    spacings_mm: tuple[float, ...]
    sensor: SimulatedSensor = SimulatedSensor.ViTacTip
    #: Thickness in mm of the gel on the sensor's skin.
    gel_mm: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the outputs: of classes, or of labels."""
        if self.task is SensorTask.grating:
            return tuple(f"{spacing:g} mm" for spacing in self.spacings_mm)
        return OUTPUTS[self.task]

    def describe(self) -> Json:
        """Name everything that determines the images."""
        spacings = self.spacings_mm if self.task is SensorTask.grating else ()
        later: dict[str, Json] = {} if self.sensor is SimulatedSensor.ViTacTip else {"sensor": self.sensor.value}
        later |= {"gel_mm": float(self.gel_mm)} if self.gel_mm else {}
        return {
            **later,
            "source": "simulated",
            "version": SIMULATOR_VERSION,
            "task": self.task.value,
            "images": self.images,
            "image_size": self.image_size,
            "seed": self.seed,
            "sensor_seed": self.sensor_seed,
            "light": self.light.value,
            "spacings_mm": [float(spacing) for spacing in spacings],
        }

    def catalogue(self) -> Catalogue:
        """Sample every press and its label; draw no picture."""
        labels = [_press(self, index)[1] for index in range(self.images)]
        is_grating = self.task is SensorTask.grating
        return Catalogue(
            kind=Kind.classification if is_grating else Kind.regression,
            names=self.names,
            units=UNITS.get(self.task),
            labels=np.array(labels, dtype=np.int64).reshape(-1) if is_grating else np.array(labels, dtype=np.float64),
            image_size=self.image_size,
            pictures=tuple(partial(draw, self, index) for index in range(self.images)),
            selected=(f"data.gel_mm={canonical(float(self.gel_mm))}",) if self.gel_mm else (),
        )


def draw(source: Simulated, index: int) -> Picture:
    """Draw one picture: uint8, shape (3, image_size, image_size)."""
    press, _, rng = _press(source, index)
    sensor = make_sensor(source.image_size, source.sensor_seed, source.gel_mm)
    return picture(sensor, press, rng, source.light, source.sensor)


def _press(source: Simulated, index: int) -> tuple[Press, tuple[float, ...], np.random.Generator]:
    """Sample one press and its label; the generator is left where the picture takes it up."""
    match source.task:
        case SensorTask.force:
            rng = stream(source.seed, "simulate", "force", index)
            return *_force(rng), rng
        case SensorTask.grating:
            kind, number = _class_and_number(index, source.images, len(source.spacings_mm))
            rng = stream(source.seed, "simulate", "grating", kind, number)
            return _grating(rng, source.spacings_mm[kind]), (kind,), rng
        case SensorTask.hardness:
            rng = stream(source.seed, "simulate", "hardness", index)
            return *_hardness(rng), rng


def _class_and_number(index: int, images: int, classes: int) -> tuple[int, int]:
    """Find the class of a row, and its number there, where rows stand class by class, as even as possible."""
    size, larger = divmod(images, classes)
    if index < larger * (size + 1):
        return divmod(index, size + 1)
    kind, number = divmod(index - larger * (size + 1), size)
    return larger + kind, number


def _force(rng: np.random.Generator) -> tuple[Press, tuple[float, ...]]:
    """Press a rigid ball and push it sideways; the label is the force in N as a real force sensor reads it.

    The reading has hysteresis, noise and a resolution of 0.1 mN: the error that no network can undo.
    """
    x, y = _position(rng, 9.0)
    depth, stroke = rng.uniform(0.15, 2.6), rng.uniform(0, STROKE)
    radius = combined_radius(4.0, DOME_RADIUS)
    reach = contact_radius(depth, radius)
    modulus = SOFT_SKIN * rim_softness(x, y)
    pressed = normal_force(depth, radius, contact_modulus(modulus, SKIN_POISSON))
    slip, stick, lean = _sheared(stroke, _direction(rng.uniform()), pressed, reach, modulus)
    press = Press(
        x=x,
        y=y,
        contact_radius=reach,
        radius=radius,
        share=1.0,
        slip_limit=slip,
        stick_radius=stick,
        lean=lean,
        brightness=normal_number(rng, 55, 4) * (0.2 + 0.55 * depth),  # deeper, more of the rough surface touches
        fading=0.35,
    )
    hysteresis = normal_number(rng, 1, HYSTERESIS)
    truth = (lean[0] * DOME_STIFFNESS, lean[1] * DOME_STIFFNESS, -pressed)
    errors = normal(rng, FORCE_NOISE, (3,))
    return press, tuple(round(hysteresis * part + float(error), 4) for part, error in zip(truth, errors, strict=True))


def rim_softness(x: float, y: float) -> float:
    """Share of the skin's modulus that a contact at (x, y) meets: a dome of its kind is softer towards its rim.

    1 / (1 + 0.5 (rho / 15 mm)^2), after the sensitivity map of TacEva's ViTacTip (5 at the centre to 8 at the rim).
    """
    return 1 / (1 + 0.5 * (x * x + y * y) / 15**2)


def _grating(rng: np.random.Generator, spacing: float) -> Press:
    """Press a rigid plate with ridges onto the dome, nearly upright.

    The skin follows a groove as far as its mean pressure goes towards closing it; of a square profile the amplitude
    of the first harmonic counts, 2 / pi of its depth. A wider groove is darker, because its walls send less light back,
    and the plate keeps out the light that shines through the skin from outside.
    """
    x, y = _position(rng, 3.0)
    depth = rng.uniform(0.5, 2.2)
    width = spacing * normal_number(rng, 1, WIDTH_ERROR)
    reach = contact_radius(depth, DOME_RADIUS)
    modulus = contact_modulus(SOFT_SKIN, SKIN_POISSON)
    pressed = normal_force(depth, DOME_RADIUS, modulus)
    period, amplitude = 2 * width, 2 / math.pi * GROOVE_DEPTH
    brightness = normal_number(rng, 60, 6)
    bottom = (brightness + PLATE_SHADE) * float(exp_minus(width / GROOVE_FADING)) - PLATE_SHADE
    conformity = min(1.0, mean_pressure(pressed, reach) / conforming_pressure(amplitude, period, modulus))
    grating = Grating(
        period=period,
        across=_direction(normal_number(rng, 0, GRATING_YAW / (2 * math.pi))),
        phase=rng.uniform(),
        groove=bottom / brightness,
        imprint=amplitude * conformity,
        side=PLATE_SIDE,
    )
    slid, stick, lean = _slid(normal(rng, 0.15, (2,)), pressed, reach, SOFT_SKIN)
    return Press(
        x=x,
        y=y,
        contact_radius=reach,
        radius=DOME_RADIUS,
        share=1.0,
        slip_limit=slid,
        stick_radius=stick,
        lean=lean,
        brightness=brightness,
        fading=0.5,
        grating=grating,
    )


def _hardness(rng: np.random.Generator) -> tuple[Press, tuple[float, ...]]:
    """Press a rubber ball: a harder one takes less of the approach itself, and looks a little brighter."""
    shore = SHORE_LEVELS[rng.integers(len(SHORE_LEVELS))]
    x, y = _position(rng, 2.0)
    depth = rng.uniform(1.3, 1.9)
    radius = combined_radius(8.0, DOME_RADIUS)
    reach = contact_radius(depth, radius)
    rigid = contact_modulus(STIFF_SKIN, SKIN_POISSON)
    both = contact_modulus(STIFF_SKIN, SKIN_POISSON, modulus_of_shore(shore), SKIN_POISSON)
    slid, stick, lean = _slid(normal(rng, 0.1, (2,)), normal_force(depth, radius, both), reach, STIFF_SKIN)
    press = Press(
        x=x,
        y=y,
        contact_radius=reach,
        radius=radius,
        share=both / rigid,
        slip_limit=slid,
        stick_radius=stick,
        lean=lean,
        brightness=40 + 3.2 * (shore - SHORE_LEVELS[0]) + normal_number(rng, 0, SPECIMEN_NOISE),
        fading=0.25,
    )
    return press, (shore,)


def _slid(
    sideways: npt.NDArray[np.float64], pressed: float, reach: float, modulus: float
) -> tuple[tuple[float, float], float, tuple[float, float]]:
    """Push a contact by a stroke (x, y) in mm; return what `_sheared` does."""
    along_x, along_y = (float(part) for part in sideways)
    stroke = math.sqrt(along_x * along_x + along_y * along_y)
    length = max(stroke, 1e-9)
    return _sheared(stroke, (along_x / length, along_y / length), pressed, reach, modulus)


def _sheared(
    stroke: float, along: tuple[float, float], pressed: float, reach: float, modulus: float
) -> tuple[tuple[float, float], float, tuple[float, float]]:
    """Push a contact by a stroke along a unit vector; return slip limit (x, y), stick radius and lean (x, y), in mm."""
    limit = slip_limit(pressed, reach, FRICTION, modulus, SKIN_POISSON)
    sheared = contact_displacement(stroke, limit, pressed, FRICTION, DOME_STIFFNESS)
    leant = tangential_force(sheared, limit, pressed, FRICTION) / DOME_STIFFNESS
    across, down = along
    return (limit * across, limit * down), stick_radius(sheared, limit, reach), (leant * across, leant * down)


def _position(rng: np.random.Generator, reach: float) -> tuple[float, float]:
    """Draw a point in a disc around the sensor's axis, uniform over its area; mm."""
    along_x, along_y = _direction(rng.uniform())
    distance = reach * math.sqrt(rng.uniform())
    return distance * along_x, distance * along_y


def _direction(turns: float) -> tuple[float, float]:
    """Unit vector at an angle in whole turns."""
    return float(cosine(turns)), float(sine(turns))
