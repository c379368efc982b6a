"""Contact mechanics: closed forms agree with their limits, with each other, and with numbers computed by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import dblquad

from tacevo.data.simulator.contact import (
    combined_radius,
    conforming_pressure,
    contact_displacement,
    contact_modulus,
    contact_radius,
    imprint_at_depth,
    mean_pressure,
    modulus_of_shore,
    normal_field,
    normal_force,
    shear_field,
    slip_limit,
    spread_radius,
    stick_radius,
    tangential_force,
)

LENGTH = st.floats(0.1, 10)


def test_moduli_and_radii_combine_as_springs_in_series() -> None:
    """Two equal bodies give half the modulus and half the radius; a rigid one changes nothing."""
    assert contact_modulus(2.0, 0.5, 2.0, 0.5) == pytest.approx(contact_modulus(2.0, 0.5) / 2)
    assert contact_modulus(0.75, 0.5) == pytest.approx(1.0)
    assert combined_radius(4.0, 4.0) == pytest.approx(2.0)


@pytest.mark.parametrize("depth", [0.0, 0.2, 1.0, 3.0, 20.0])
def test_contact_is_as_wide_below_as_its_displacement_says(depth: float) -> None:
    """On the axis at a depth, the displacement under Hertz's pressure is that of a wider contact of the same force."""
    place = (np.arange(100_000) + 0.5) / 100_000  # a = R = E* = 1, so p = 2 sqrt(1 - r^2) / pi, 4 pi G = pi
    apart = np.hypot(place, depth)  # Boussinesq of each ring, with nu = 0.5
    rings = 2 / math.pi * np.sqrt(1 - place**2) * (1 / apart + depth**2 / apart**3) * 2 * place
    force = normal_force(1.0, 1.0, 1.0)
    assert 3 * force / (4 * spread_radius(1.0, depth)) == pytest.approx(rings.mean(), rel=0.02)


@given(depth=LENGTH, radius=LENGTH)
def test_contact_grows_with_the_cube_root_of_the_force(depth: float, radius: float) -> None:
    """Hertz: eight times the force doubles the contact radius and needs four times the approach."""
    force = normal_force(depth, radius, 0.2)
    assert normal_force(4 * depth, radius, 0.2) == pytest.approx(8 * force)
    assert contact_radius(4 * depth, radius) == pytest.approx(2 * contact_radius(depth, radius))
    assert contact_radius(depth, radius) == pytest.approx((3 * force * radius / (4 * 0.2)) ** (1 / 3))
    assert depth == pytest.approx((9 * force**2 / (16 * radius * 0.2**2)) ** (1 / 3))


@pytest.mark.parametrize("distance", [0.0, 1.0, 2.5, 6.0])
def test_displacement_is_what_the_pressure_causes(distance: float) -> None:
    """Boussinesq's point forces, summed over Hertz's pressure 3/2 p_mean sqrt(1 - r^2/a^2), give the same field."""
    radius, depth, modulus = 4.0, 1.0, 0.3
    reach = contact_radius(depth, radius)
    peak = 1.5 * mean_pressure(normal_force(depth, radius, modulus), reach)

    def contribution(length: float, angle: float) -> float:
        # In polar coordinates around the point of interest the singularity 1 / length and the area's factor cancel.
        squared = distance**2 + length**2 + 2 * distance * length * math.cos(angle)
        return peak * math.sqrt(max(1 - squared / reach**2, 0)) / (math.pi * modulus)

    summed, _ = dblquad(contribution, 0, 2 * math.pi, 0, distance + reach, epsabs=1e-5, epsrel=1e-5)
    displacement, _ = normal_field(np.array([max(distance, 1e-9)]), reach, radius)
    assert displacement[0] == pytest.approx(summed, rel=1e-3)


@given(reach=LENGTH, radius=LENGTH)
def test_surface_follows_the_ball_inside_the_contact(reach: float, radius: float) -> None:
    """The displacement is the approach minus the ball's parabola, and the slope is -r/R."""
    distance = np.linspace(1e-9, reach, 5)
    displacement, slope = normal_field(distance, reach, radius)
    assert displacement == pytest.approx((reach**2 - distance**2 / 2) / radius)
    assert slope * distance == pytest.approx(-distance / radius)
    assert np.array_equal(normal_field(distance, 0.0, radius), np.zeros((2, 5)))


@given(reach=LENGTH, radius=LENGTH)
def test_slope_is_the_derivative_of_the_displacement(reach: float, radius: float) -> None:
    """Central differences outside the contact agree with the closed form."""
    distance, step = reach * np.array([1.1, 1.5, 3.0, 6.0]), 1e-5 * reach
    ahead, behind = (normal_field(distance + side, reach, radius)[0] for side in (step, -step))
    _, slope = normal_field(distance, reach, radius)
    assert slope * distance == pytest.approx((ahead - behind) / (2 * step), rel=1e-5)


def test_far_field_is_that_of_a_point_force() -> None:
    """Far away w = F / (pi E* r), Boussinesq's solution, for every shape of the contact."""
    depth, radius, modulus, distance = 1.0, 4.0, 0.3, np.array([400.0])
    displacement, _ = normal_field(distance, math.sqrt(radius * depth), radius)
    assert displacement == pytest.approx(
        normal_force(depth, radius, modulus) / (math.pi * modulus * distance), rel=1e-4
    )


def sheared(x: float, y: float, stick: float, poisson: float = 0.4) -> list[float]:
    """Return the displacement (x, y) at a point; a contact of 1.5 mm radius and a slip limit of 0.3 mm along x."""
    fields = shear_field(np.array([x]), np.array([y]), 1.5, stick=stick, limit=(0.3, 0.0), poisson=poisson)
    return [float(field[0]) for field in fields]


@pytest.mark.slow
@pytest.mark.parametrize("stick", [0.0, 0.8, 1.2])
@pytest.mark.parametrize(("x", "y"), [(2.5, 0.0), (1.2, 1.4), (0.3, 0.2), (0.0, 3.0)])
def test_shear_is_what_the_traction_causes(x: float, y: float, stick: float) -> None:
    """Cerruti's point forces, summed over Cattaneo and Mindlin's traction, give the same field, inside and outside."""
    reach, poisson, shear_modulus, limit = 1.5, 0.4, 0.05, 0.3
    friction = limit * 16 * shear_modulus * reach / (3 * (2 - poisson))  # mu F

    def traction(distance: float) -> float:
        sliding = math.sqrt(max(1 - (distance / reach) ** 2, 0))
        sticking = stick / reach * math.sqrt(max(1 - (distance / stick) ** 2, 0)) if stick else 0.0
        return 3 * friction / (2 * math.pi * reach**2) * (sliding - sticking)

    def summed(along: bool) -> float:
        def contribution(length: float, angle: float) -> float:
            # In polar coordinates around the point of interest the kernel's 1 / length and the area's factor cancel.
            cosine, sine = math.cos(angle), math.sin(angle)
            kernel = 1 - poisson + poisson * cosine**2 if along else poisson * cosine * sine
            return traction(math.hypot(x + length * cosine, y + length * sine)) * kernel / (2 * math.pi * shear_modulus)

        return dblquad(contribution, 0, 2 * math.pi, 0, math.hypot(x, y) + reach, epsabs=1e-5, epsrel=1e-4)[0]

    assert sheared(x, y, stick) == pytest.approx([summed(True), summed(False)], abs=3e-4)


def test_sticking_disc_moves_as_one_piece_and_the_edge_lags() -> None:
    """Within the stick radius the skin follows the indenter; towards the edge it slips back; far away it rests."""
    stick = stick_radius(0.2, 0.3, 1.5)
    assert [sheared(x, 0.0, stick)[0] for x in (1e-6, 0.4, 0.8)] == pytest.approx([0.2] * 3)
    assert 0 < sheared(1.5, 0.0, stick)[0] < 0.15
    assert sheared(100.0, 0.0, stick)[0] < 0.005
    assert sheared(0.0, 3.0, stick)[0] < sheared(3.0, 0.0, stick)[0]
    assert sheared(0.7, 0.3, stick_radius(0.0, 0.3, 1.5)) == [0.0, 0.0]  # of what was not pushed


@given(stroke=st.floats(0, 0.5))
def test_stick_radius_follows_the_force(stroke: float) -> None:
    """It is a (1 - Q / mu F)^(1/3), as Cattaneo and Mindlin write it, and no disc sticks once all slides."""
    force = tangential_force(stroke, 0.3, 1.0, 0.66)
    assert stick_radius(stroke, 0.3, 1.5) == pytest.approx(1.5 * max(1 - force / 0.66, 0) ** (1 / 3), abs=1e-6)


@pytest.mark.parametrize("stick", [0.0, 1.0])
def test_far_field_of_shear_is_that_of_a_point_force(stick: float) -> None:
    """Far away Q / (2 pi G r) ahead and (1 - nu) of it aside, with the Q of the label, for every slip."""
    poisson, shear_modulus, limit, reach, far = 0.4, 0.05, 0.3, 1.5, 1_000.0
    friction = limit * 16 * shear_modulus * reach / (3 * (2 - poisson))
    force = tangential_force(limit * (1 - (stick / reach) ** 2), limit, friction, 1.0)
    point = force / (2 * math.pi * shear_modulus * far)
    assert [sheared(far, 0.0, stick)[0], sheared(0.0, far, stick)[0]] == pytest.approx(
        [point, (1 - poisson) * point], rel=1e-3
    )


@given(stroke=st.floats(0, 3), depth=st.floats(0.1, 3))
def test_shear_force_never_exceeds_friction(stroke: float, depth: float) -> None:
    """Coulomb's limit holds, and is reached exactly at the slip limit."""
    normal, reach = normal_force(depth, 4.0, 0.18), contact_radius(depth, 4.0)
    limit = slip_limit(normal, reach, 0.66, 0.14, 0.49)
    assert 0 <= tangential_force(stroke, limit, normal, 0.66) <= 0.66 * normal
    assert tangential_force(limit, limit, normal, 0.66) == pytest.approx(0.66 * normal)


@pytest.mark.parametrize(("period", "left"), [(4.0, 0.53), (2.0, 0.18), (1.0, 0.014)])
def test_fine_gratings_do_not_reach_the_inner_skin(period: float, left: float) -> None:
    """Below 1 mm of skin, periods of 4, 2 and 1 mm keep 53 %, 18 % and 1.4 % of their imprint: (1 + kz) exp(-kz)."""
    k = 2 * math.pi / period
    assert (
        imprint_at_depth(period, 1.0)
        == pytest.approx((1 + k) * math.exp(-k), rel=1e-4)
        == pytest.approx(left, rel=0.05)
    )


def test_conforming_pressure_flattens_exactly_one_wave() -> None:
    """A half-space under p cos kx waves by 2 p / (E* k); at Westergaard's pressure that is the groove's amplitude."""
    amplitude, period, modulus = 0.2, 1.5, 0.18
    pressure = conforming_pressure(amplitude, period, modulus)
    assert 2 * pressure / (modulus * 2 * math.pi / period) == pytest.approx(amplitude)


@pytest.mark.parametrize(("shore", "modulus"), [(17.5, 0.645), (30.0, 1.142)])
def test_modulus_of_rubber_follows_gent(shore: float, modulus: float) -> None:
    """The two ends of the hardness range, in MPa."""
    assert modulus_of_shore(shore) == pytest.approx(modulus, abs=1e-3)


@given(stroke=st.floats(0, 5), pressed=st.floats(0.01, 3), limit=st.floats(0.05, 3), stiffness=st.floats(0.1, 5))
def test_contact_and_body_share_a_stroke_and_carry_one_force(
    stroke: float, pressed: float, limit: float, stiffness: float
) -> None:
    """Springs in series: what the contact leaves of the stroke stretches the body by exactly the contact's force."""
    sheared = contact_displacement(stroke, limit, pressed, 0.66, stiffness)
    assert 0 <= sheared <= stroke
    force = tangential_force(sheared, limit, pressed, 0.66)
    assert (stroke - sheared) * stiffness == pytest.approx(force, abs=1e-9)


def test_long_stroke_slides_and_a_stiff_body_takes_none_of_it() -> None:
    """At mu F = 0.66 N a body of 0.5 N/mm stretches by 1.32 mm and no more; a rigid one leaves all to the contact."""
    assert contact_displacement(5.0, 0.3, 1.0, 0.66, 0.5) == pytest.approx(5.0 - 1.32)
    assert contact_displacement(0.2, 0.3, 1.0, 0.66, 1e9) == pytest.approx(0.2)
