"""Contact mechanics of a soft skin: the formulas behind the simulated sensor, all pure.

Lengths in mm, forces in N, moduli in MPa. Formulas are those of Johnson, Contact Mechanics (1985), chapters 4, 7
and 13, unless a docstring says otherwise. They hold for small strains of a homogeneous half-space; the simulator uses
them beyond that, so its moduli are effective constants.
"""

import math

import numpy as np
import numpy.typing as npt

Field = npt.NDArray[np.float64]


def contact_modulus(
    modulus: float, poisson: float, other_modulus: float = math.inf, other_poisson: float = 0.0
) -> float:
    """Combine two bodies' moduli: 1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2; by default the other is rigid."""
    return 1 / ((1 - poisson**2) / modulus + (1 - other_poisson**2) / other_modulus)


def combined_radius(radius: float, other: float) -> float:
    """Combine the radii of two convex surfaces in contact: 1/R = 1/R1 + 1/R2."""
    return 1 / (1 / radius + 1 / other)


def normal_force(depth: float, radius: float, modulus: float) -> float:
    """Hertz's force at an approach `depth`: F = 4/3 E* sqrt(R) d^1.5; the contact radius is sqrt(R d)."""
    return 4 / 3 * modulus * math.sqrt(radius * depth) * depth


def normal_field(distance: Field, contact_radius: float, radius: float) -> tuple[Field, Field]:
    """Find the surface displacement under Hertz's pressure, and its slope.

    With s = min(a/r, 1) and q = sqrt(1 - s^2) one expression holds inside and outside the contact.

    Args:
        distance: r >= 0 from the centre of the contact, any shape.
        contact_radius: a > 0.
        radius: R, of the combined surfaces.

    Returns:
        Displacement w away from the indenter and dw/dr, in the shape of `distance`; w(0) = a^2/R, the approach.
    """
    share = np.minimum(contact_radius / np.maximum(distance, contact_radius), 1.0)
    angle = np.arcsin(share)
    root = share * np.sqrt(1 - share * share)
    squared = distance * distance
    displacement = ((2 * contact_radius**2 - squared) * angle + squared * root) / (math.pi * radius)
    slope = -2 * distance * (angle - root) / (math.pi * radius)
    return displacement, slope


def slip_limit(normal: float, contact_radius: float, friction: float, modulus: float, poisson: float) -> float:
    """Find the tangential displacement at which a contact slides as a whole (Cattaneo, Mindlin).

    3 mu F (2 - nu) / (16 G a), with the skin's own modulus E = 2 G (1 + nu) and a rigid indenter.
    """
    shear_modulus = modulus / (2 * (1 + poisson))
    return 3 * friction * normal * (2 - poisson) / (16 * shear_modulus * contact_radius)


def tangential_force(displacement: float, limit: float, normal: float, friction: float) -> float:
    """Find the shear force at a tangential displacement >= 0: mu F [1 - (1 - d/limit)^1.5], at most mu F."""
    sticking = max(1 - displacement / limit, 0.0)
    return friction * normal * (1 - sticking * math.sqrt(sticking))


def shear_field(
    x: Field, y: Field, contact_radius: float, shear: tuple[float, float], poisson: float
) -> tuple[Field, Field]:
    """Find the tangential displacement around a contact that moves sideways without slip.

    It is uniform inside the contact and decays outside (traction q0 (1 - r^2/a^2)^-1/2).

    Args:
        x: from the centre of the contact, any shape.
        y: as `x`.
        contact_radius: a > 0.
        shear: displacement (x, y) of the contact.
        poisson: ratio nu of the skin.

    Returns:
        Displacement in x and in y, in the shape of `x`.
    """
    squared = np.maximum(x * x + y * y, 1e-12)
    share = np.minimum(contact_radius / np.sqrt(squared), 1.0)
    common = np.arcsin(share) / (math.pi / 2)
    twist = poisson / ((2 - poisson) * math.pi / 2) * share * np.sqrt(1 - share * share)
    cosine, sine = (x * x - y * y) / squared, 2 * x * y / squared
    along, across = shear
    return (
        along * (common + twist * cosine) + across * twist * sine,
        across * (common - twist * cosine) + along * twist * sine,
    )


def imprint_at_depth(period: float, depth: float) -> float:
    """Share of a periodic surface imprint that is left at a depth: (1 + kz) exp(-kz), k = 2 pi / period, nu = 0.5."""
    phase = 2 * math.pi / period * depth
    return (1 + phase) * math.exp(-phase)


def modulus_of_shore(shore: float) -> float:
    """Young's modulus in MPa of a rubber of Shore A hardness 10 to 90 (Gent 1958, doi:10.5254/1.3542351)."""
    return 0.0981 * (56 + 7.62336 * shore) / (0.137505 * (254 - 2.54 * shore))
