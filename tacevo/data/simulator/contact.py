"""Contact mechanics of a soft skin: the formulas behind the simulated sensor, all pure.

Lengths in mm, forces in N, moduli and pressures in MPa. Johnson is Contact Mechanics (Cambridge University Press,
1985). The formulas hold for small strains of a homogeneous half-space; the simulator uses them beyond that, so its
moduli are effective constants.
"""

import math

import numpy as np

from tacevo.data.simulator.portable import Field, arctan, exp_minus


def contact_modulus(
    modulus: float, poisson: float, other_modulus: float = math.inf, other_poisson: float = 0.0
) -> float:
    """Combine two bodies' moduli: 1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2 (Johnson, section 4.2)."""
    return 1 / ((1 - poisson * poisson) / modulus + (1 - other_poisson * other_poisson) / other_modulus)


def combined_radius(radius: float, other: float) -> float:
    """Combine the radii of two convex surfaces in contact: 1/R = 1/R1 + 1/R2 (Johnson, section 4.2)."""
    return 1 / (1 / radius + 1 / other)


def contact_radius(depth: float, radius: float) -> float:
    """Hertz's contact radius at an approach `depth`: a = sqrt(R d) (Johnson, eq. 4.23)."""
    return math.sqrt(radius * depth)


def normal_force(depth: float, radius: float, modulus: float) -> float:
    """Hertz's force at an approach `depth`: F = 4/3 E* sqrt(R) d^1.5 (Johnson, eq. 4.23)."""
    return 4 / 3 * modulus * math.sqrt(radius * depth) * depth


def mean_pressure(force: float, contact_radius: float) -> float:
    """Spread a force over its contact: F / (pi a^2), two thirds of Hertz's greatest pressure (Johnson, eq. 4.24)."""
    return force / (math.pi * contact_radius * contact_radius)


def normal_field(distance: Field, contact_radius: float, radius: float) -> tuple[Field, Field]:
    """Find the surface displacement under Hertz's pressure, and its slope (Johnson, eqs. 3.41a and 3.42a).

    With s = min(a/r, 1) and q = sqrt(1 - s^2) one expression holds inside and outside the contact.

    The distance r > 0 is from the centre of the contact, the contact's radius a >= 0, and R that of the surfaces.

    Returns:
        Displacement w away from the indenter and (dw/dr)/r, in the shape of `distance`; w(0) = a^2/R, the approach.
    """
    share = contact_radius / np.maximum(distance, contact_radius)
    cosine = np.sqrt(1 - share * share)
    angle = 2 * arctan(share / (1 + cosine))  # the arcsine of the share
    root = share * cosine
    squared = distance * distance
    displacement = ((2 * contact_radius * contact_radius - squared) * angle + squared * root) * (1 / (math.pi * radius))
    return displacement, (root - angle) * (2 / (math.pi * radius))


def slip_limit(normal: float, contact_radius: float, friction: float, modulus: float, poisson: float) -> float:
    """Find the tangential displacement at which a contact slides as a whole (Cattaneo, Mindlin; Johnson, section 7.2).

    3 mu F (2 - nu) / (16 G a), with the skin's own modulus E = 2 G (1 + nu) and a rigid indenter.
    """
    shear_modulus = modulus / (2 * (1 + poisson))
    return 3 * friction * normal * (2 - poisson) / (16 * shear_modulus * contact_radius)


def tangential_force(displacement: float, limit: float, normal: float, friction: float) -> float:
    """Find the shear force at a tangential displacement >= 0 (Cattaneo, Mindlin; Johnson, section 7.2).

    mu F [1 - (1 - d/limit)^1.5]: the contact slips from its edge inwards until, at the limit, all of it slides at mu F.
    """
    sticking = max(1 - displacement / limit, 0.0)
    return friction * normal * (1 - sticking * math.sqrt(sticking))


def contact_displacement(stroke: float, limit: float, normal: float, friction: float, stiffness: float) -> float:
    """Find how much of a sideways stroke shears the contact, where the body behind it gives way like a spring.

    Solves d + Q(d) / k = stroke for d, with Q of `tangential_force`, to the last bit or two by bisection: both springs
    carry the same force, and what exceeds the spring's stretch at mu F is sliding. The stroke >= 0 is that of the
    object against the body's support; at the limit > 0 all of the contact slides; the stiffness k > 0 is in N/mm.

    Returns:
        d in mm, in [0, stroke].
    """
    sliding = stroke - friction * normal / stiffness
    if sliding >= limit:
        return sliding
    low, high = 0.0, min(stroke, limit)
    for _ in range(60):
        middle = (low + high) / 2
        if middle + tangential_force(middle, limit, normal, friction) / stiffness < stroke:
            low = middle
        else:
            high = middle
    return low


def stick_radius(displacement: float, limit: float, contact_radius: float) -> float:
    """Find the radius within which a sheared contact still sticks: a sqrt(1 - d/limit), 0 where all of it slides.

    Cattaneo and Mindlin's c = a (1 - Q / mu F)^(1/3) (Johnson, eq. 7.42), with Q expressed by the displacement.
    """
    return contact_radius * math.sqrt(max(1 - displacement / limit, 0.0))


def shear_field(
    x: Field, y: Field, contact_radius: float, *, stick: float, limit: tuple[float, float], poisson: float
) -> tuple[Field, Field]:
    """Find the tangential displacement around a contact that slips from its edge down to a stick radius.

    The traction is friction on the whole contact, mu p(r), less the same law on the sticking disc (Johnson, section
    7.2); each part's field is that of eqs. 3.91 and 3.92, whose sum is uniform within the sticking disc.

    Args:
        x: from the centre of the contact, any shape; nowhere 0 together with y.
        y: as `x`.
        contact_radius: a > 0.
        stick: c in [0, a]; a means no shear, 0 that all of the contact slides.
        limit: displacement (x, y) of the centre at which all slides, see `slip_limit`.
        poisson: ratio nu of the skin.

    Returns:
        Displacement in x and in y, in the shape of `x`.
    """
    squared = x * x + y * y
    outer, inner = (_friction_field(squared, radius, poisson) for radius in (contact_radius, stick))
    factor = 1 / (math.pi * (2 - poisson) * contact_radius * contact_radius)
    common, twist = ((one - other) * factor for one, other in zip(outer, inner, strict=True))
    double_cosine, double_sine = (x * x - y * y) / squared, 2 * x * y / squared  # of twice the polar angle
    along, across = limit
    return (
        along * (common + twist * double_cosine) + across * twist * double_sine,
        across * (common - twist * double_cosine) + along * twist * double_sine,
    )


def _friction_field(squared: Field, radius: float, poisson: float) -> tuple[Field, Field]:
    """Field of the traction (1 - r^2/a^2)^1/2, apart from factors: its mean part, and that of twice the polar angle."""
    area = radius * radius
    share = radius / np.maximum(np.sqrt(squared), max(radius, 1e-12))
    cosine = np.sqrt(1 - share * share)
    angle, root = 2 * arctan(share / (1 + cosine)), share * cosine
    mean = (2 - poisson) * ((2 * area - squared) * angle + squared * root)
    return mean, (poisson / 2) * (squared * angle + (2 * area - squared) * root)


def conforming_pressure(amplitude: float, period: float, modulus: float) -> float:
    """Find the mean pressure that closes a sinusoidal groove: pi E* D / l (Westergaard; Johnson, section 13.2)."""
    return math.pi * modulus * amplitude / period


def imprint_at_depth(period: float, depth: float) -> float:
    """Find the share of a periodic surface imprint that is left at a depth below it.

    (1 + kz) exp(-kz) with k = 2 pi / period, for an incompressible half-space in plane strain under a pressure
    p cos kx: the stress function is (1 + kz) exp(-kz) cos kx, up to a factor.
    """
    phase = 2 * math.pi / period * depth
    return (1 + phase) * float(exp_minus(phase))


def spread_radius(contact_radius: float, depth: float) -> float:
    """Find the radius of the contact whose surface bends as the material does at a depth below one of the same force.

    sqrt(a^2 + (3 pi z / 8)^2). The displacement at a depth z on the axis below a point force is 2 F / (pi E* z) in an
    incompressible half-space (Boussinesq; Johnson, eq. 3.19), and Hertz's in the middle of a contact is 3 F / (4 E* a).
    So this is exact at the surface, far away and below a point force; between them it is right to 2 % on the axis.
    """
    reach = 3 * math.pi / 8 * depth
    return math.sqrt(contact_radius * contact_radius + reach * reach)


def modulus_of_shore(shore: float) -> float:
    """Young's modulus in MPa of a rubber of a Shore A hardness (Gent 1958, doi:10.5254/1.3542351).

    Measured for 40 and above; below, where the specimens of the hardness task are, it is a smooth continuation.
    """
    return 0.0981 * (56 + 7.62336 * shore) / (0.137505 * (254 - 2.54 * shore))
