"""The simulated sensor as a source: seeded presses of three tasks with their labels.

Promises: image and label of an index depend on (seed, task, index, image size, spacings) and on nothing else, so
the number of workers and the order of drawing cannot matter. What it does not promise: that a network trained
here works on a real sensor.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from functools import partial

import numpy as np

from tacevo.data.contact import (
    combined_radius,
    contact_modulus,
    modulus_of_shore,
    normal_force,
    slip_limit,
    tangential_force,
)
from tacevo.data.sensor import DOME_RADIUS, SKIN_POISSON, Grating, Press, make_sensor, picture
from tacevo.data.source import Catalogue, Picture
from tacevo.errors import ConfigError
from tacevo.randomness import stream
from tacevo.records import Json, Kind

#: Changes whenever an image or a label would change; part of the cache key.
SIMULATOR_VERSION = 1

#: Six specimens, Shore A, evenly spaced over the range of the paper's supplement.
SHORE_LEVELS = (17.5, 20.0, 22.5, 25.0, 27.5, 30.0)
FRICTION = 0.66
#: Effective Young's modulus of the sensor in MPa; for hardness the stiffer of two published calibrations, because
#: a soft sensor takes almost the whole approach whatever it presses on.
SOFT_SKIN, STIFF_SKIN = 0.14, 0.88


class SimulatedTask(StrEnum):
    """What is pressed onto the sensor, and what is to be told from the image."""

    force = "force"
    grating = "grating"
    hardness = "hardness"


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulated:
    """A simulated data set.

    `force`: three forces in N, from a ball of 4 mm radius pressed 0.15 to 2.6 mm deep and pushed sideways, with
    slip; Fz is negative in compression. `grating`: one class per spacing, as many images of each. `hardness`: the
    Shore A hardness of a rubber ball, one of six levels.
    """

    task: SimulatedTask
    #: Number of images.
    images: int
    #: Height and width in pixels: a multiple of 16 from 16 to 256.
    image_size: int
    seed: int
    #: Widths of a ridge, which is also that of a groove, in mm: one class each; used by `grating` only.
    spacings_mm: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.image_size % 16 or not 16 <= self.image_size <= 256:
            raise ConfigError(
                f"data.image_size of a simulated sensor must be a multiple of 16 from 16 to 256; got {self.image_size}"
            )
        spaced = min(self.spacings_mm, default=0) > 0 and len(set(self.spacings_mm)) == len(self.spacings_mm)
        if self.task is SimulatedTask.grating and not spaced:
            raise ConfigError(f"data.spacings_mm needs different widths above 0; got {list(self.spacings_mm)}")

    def describe(self) -> Json:
        """Name everything that determines the images."""
        spacings = self.spacings_mm if self.task is SimulatedTask.grating else ()
        return {
            "source": "simulated",
            "version": SIMULATOR_VERSION,
            "task": self.task.value,
            "images": self.images,
            "image_size": self.image_size,
            "seed": self.seed,
            "spacings_mm": [float(spacing) for spacing in spacings],
        }

    def catalogue(self) -> Catalogue:
        """Sample every press and its label; draw no picture."""
        indices = range(self.images)
        labels = [_press(self, index, _stream(self, index))[1] for index in indices]
        pictures = tuple(partial(draw, self, index) for index in indices)
        if self.task is SimulatedTask.grating:
            return Catalogue(
                kind=Kind.classification,
                names=tuple(f"{spacing:g} mm" for spacing in self.spacings_mm),
                labels=np.array(labels, dtype=np.int64).reshape(-1),
                image_size=self.image_size,
                pictures=pictures,
            )
        return Catalogue(
            kind=Kind.regression,
            names=("Fx", "Fy", "Fz") if self.task is SimulatedTask.force else ("shore",),
            labels=np.array(labels, dtype=np.float64),
            image_size=self.image_size,
            pictures=pictures,
        )


def draw(source: Simulated, index: int) -> Picture:
    """Draw one picture: uint8, shape (3, image_size, image_size)."""
    rng = _stream(source, index)
    press, _ = _press(source, index, rng)
    return picture(make_sensor(source.image_size, source.seed), press, rng)


def _stream(source: Simulated, index: int) -> np.random.Generator:
    """The generator of one image and its label."""
    return stream(source.seed, "simulate", source.task.value, index)


def _press(source: Simulated, index: int, rng: np.random.Generator) -> tuple[Press, tuple[float, ...]]:
    """Sample one press and its label."""
    match source.task:
        case SimulatedTask.force:
            return _force(rng)
        case SimulatedTask.grating:
            kind = index % len(source.spacings_mm)
            return _grating(rng, source.spacings_mm[kind]), (kind,)
        case SimulatedTask.hardness:
            return _hardness(rng)


def _force(rng: np.random.Generator) -> tuple[Press, tuple[float, ...]]:
    """Press a rigid ball and push it sideways; the label is the force in N as a real force sensor reads it.

    The reading has 4 % hysteresis, 0.02 N of noise and a resolution of 0.1 mN: the error that no network can undo.
    """
    x, y = _position(rng, 7.0)
    depth, stroke, direction = rng.uniform(0.15, 2.6), rng.uniform(0, 1.6), rng.uniform(0, 2 * math.pi)
    radius = combined_radius(4.0, DOME_RADIUS)
    contact_radius = math.sqrt(radius * depth)
    softer = 1 / (1 + 0.5 * (x * x + y * y) / 15**2)  # the dome is softer towards its rim
    modulus = SOFT_SKIN * softer
    normal = normal_force(depth, radius, contact_modulus(modulus, SKIN_POISSON))
    limit = slip_limit(normal, contact_radius, FRICTION, modulus, SKIN_POISSON)
    tangential = tangential_force(stroke, limit, normal, FRICTION)
    followed = min(stroke, limit)
    cosine, sine = math.cos(direction), math.sin(direction)
    press = Press(
        x=x,
        y=y,
        contact_radius=contact_radius,
        radius=radius,
        share=1.0,
        shear=(followed * cosine, followed * sine),
        brightness=rng.normal(55, 4) * (0.2 + 0.55 * depth),  # a deeper press touches on more of the rough surface
        fading=0.35,
    )
    hysteresis = 1 + rng.normal(0, 0.04)
    truth = (tangential * cosine, tangential * sine, -normal)
    return press, tuple(round(hysteresis * part + rng.normal(0, 0.02), 4) for part in truth)


def _grating(rng: np.random.Generator, spacing: float) -> Press:
    """Press a plate with ridges onto the dome, nearly upright (yaw of 0.15 rad standard deviation)."""
    x, y = _position(rng, 3.0)
    depth = rng.uniform(0.5, 1.6)
    grating = Grating(
        period=2 * spacing,
        yaw=rng.normal(0, 0.15),
        phase=rng.uniform(0, 2 * math.pi),
        contrast=rng.uniform(0.8, 1.0),
        imprint=rng.uniform(0.05, 0.2),
        side=12.0,
    )
    return Press(
        x=x,
        y=y,
        contact_radius=math.sqrt(DOME_RADIUS * depth),
        radius=DOME_RADIUS,
        share=0.6,
        shear=(rng.normal(0, 0.15), rng.normal(0, 0.15)),
        brightness=rng.normal(55, 4),
        fading=0.5,
        grating=grating,
    )


def _hardness(rng: np.random.Generator) -> tuple[Press, tuple[float, ...]]:
    """Press a rubber ball: a harder one takes less of the approach itself, and looks a little brighter."""
    shore = SHORE_LEVELS[rng.integers(len(SHORE_LEVELS))]
    x, y = _position(rng, 2.0)
    depth = rng.uniform(1.3, 1.9)
    radius = combined_radius(8.0, DOME_RADIUS)
    rigid = contact_modulus(STIFF_SKIN, SKIN_POISSON)
    share = contact_modulus(STIFF_SKIN, SKIN_POISSON, modulus_of_shore(shore), SKIN_POISSON) / rigid
    press = Press(
        x=x,
        y=y,
        contact_radius=math.sqrt(radius * depth),
        radius=radius,
        share=share,
        shear=(rng.normal(0, 0.1), rng.normal(0, 0.1)),
        brightness=40 + 3.2 * (shore - SHORE_LEVELS[0]) + rng.normal(0, 2.5),
        fading=0.25,
    )
    return press, (shore,)


def _position(rng: np.random.Generator, reach: float) -> tuple[float, float]:
    """Draw a point in a disc around the sensor's axis, uniform over its area; mm."""
    angle, distance = rng.uniform(0, 2 * math.pi), reach * math.sqrt(rng.uniform())
    return distance * math.cos(angle), distance * math.sin(angle)
