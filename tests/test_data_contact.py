"""Contact mechanics: closed forms agree with their limits, with each other, and with numbers computed by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacevo.data.contact import (
    combined_radius,
    contact_modulus,
    imprint_at_depth,
    modulus_of_shore,
    normal_field,
    normal_force,
    shear_field,
    slip_limit,
    tangential_force,
)

LENGTH = st.floats(0.1, 10)


def test_moduli_and_radii_combine_as_springs_in_series() -> None:
    """Two equal bodies give half the modulus and half the radius; a rigid one changes nothing."""
    assert contact_modulus(2.0, 0.5, 2.0, 0.5) == pytest.approx(contact_modulus(2.0, 0.5) / 2)
    assert contact_modulus(0.75, 0.5) == pytest.approx(1.0)
    assert combined_radius(4.0, 4.0) == pytest.approx(2.0)


def test_normal_force_of_a_hand_computed_press() -> None:
    """R = 4 mm, d = 1 mm, E* = 0.3 MPa: 4/3 * 0.3 * 2 = 0.8 N."""
    assert normal_force(1.0, 4.0, 0.3) == pytest.approx(0.8)


@given(contact_radius=LENGTH, radius=LENGTH)
def test_surface_follows_the_ball_inside_the_contact(contact_radius: float, radius: float) -> None:
    """The displacement is the approach minus the ball's parabola, and the slope is -r/R."""
    distance = np.linspace(0, contact_radius, 5)
    displacement, slope = normal_field(distance, contact_radius, radius)
    assert displacement == pytest.approx((contact_radius**2 - distance**2 / 2) / radius)
    assert slope == pytest.approx(-distance / radius)


@given(contact_radius=LENGTH, radius=LENGTH)
def test_slope_is_the_derivative_of_the_displacement(contact_radius: float, radius: float) -> None:
    """Central differences outside the contact agree with the closed form."""
    distance, step = contact_radius * np.array([1.1, 1.5, 3.0, 6.0]), 1e-5 * contact_radius
    ahead, behind = (normal_field(distance + side, contact_radius, radius)[0] for side in (step, -step))
    _, slope = normal_field(distance, contact_radius, radius)
    assert slope == pytest.approx((ahead - behind) / (2 * step), rel=1e-6)


def test_far_field_is_that_of_a_point_force() -> None:
    """Far away w = F / (pi E* r), Boussinesq's solution, whatever the shape of the contact."""
    depth, radius, modulus, distance = 1.0, 4.0, 0.3, np.array([400.0])
    displacement, _ = normal_field(distance, math.sqrt(radius * depth), radius)
    assert displacement == pytest.approx(
        normal_force(depth, radius, modulus) / (math.pi * modulus * distance), rel=1e-4
    )


def test_shear_moves_the_contact_as_one_piece_and_fades_outside() -> None:
    """Inside, the skin follows; far away it rests; along the shear it moves more than across."""
    x, y = np.array([0.0, 0.5, 100.0, 3.0, 0.0]), np.array([0.0, 0.5, 0.0, 0.0, 3.0])
    along, across = shear_field(x, y, 1.0, (0.2, 0.0), 0.5)
    assert along[:2] == pytest.approx(0.2)
    assert across == pytest.approx(0.0)
    assert along[2] < 0.005
    assert 0 < along[4] < along[3] < 0.2


def test_far_field_of_shear_is_that_of_a_point_force() -> None:
    """Far away Q / (2 pi G r) ahead and (1 - nu) of it aside, Cerruti's solution, for nu = 0.4."""
    poisson, shear_modulus, displacement, far = 0.4, 0.05, 0.2, 1_000.0
    force = 8 * shear_modulus * 1.0 / (2 - poisson) * displacement
    along, _ = shear_field(np.array([far, 0.0]), np.array([0.0, far]), 1.0, (displacement, 0.0), poisson)
    point = force / (2 * math.pi * shear_modulus * far)
    assert along == pytest.approx([point, (1 - poisson) * point], rel=1e-4)


@given(stroke=st.floats(0, 3), depth=st.floats(0.1, 3))
def test_shear_force_never_exceeds_friction(stroke: float, depth: float) -> None:
    """Coulomb's limit holds, and is reached exactly at the slip limit."""
    normal, contact_radius = normal_force(depth, 4.0, 0.18), math.sqrt(4.0 * depth)
    limit = slip_limit(normal, contact_radius, 0.66, 0.14, 0.49)
    assert 0 <= tangential_force(stroke, limit, normal, 0.66) <= 0.66 * normal
    assert tangential_force(limit, limit, normal, 0.66) == pytest.approx(0.66 * normal)


def test_small_shear_has_the_stiffness_of_full_stick() -> None:
    """Without slip the stiffness is 8 G a / (2 - nu) (Mindlin)."""
    normal, contact_radius, modulus, poisson = 0.8, 2.0, 0.15, 0.5
    limit = slip_limit(normal, contact_radius, 0.66, modulus, poisson)
    stiffness = 8 * modulus / (2 * (1 + poisson)) * contact_radius / (2 - poisson)
    assert tangential_force(1e-6, limit, normal, 0.66) == pytest.approx(stiffness * 1e-6, rel=1e-4)


@pytest.mark.parametrize(("period", "left"), [(4.0, 0.53), (2.0, 0.18), (1.0, 0.014)])
def test_fine_gratings_do_not_reach_the_inner_skin(period: float, left: float) -> None:
    """Below 1 mm of skin, periods of 4, 2 and 1 mm keep 53 %, 18 % and 1.4 % of their imprint."""
    assert imprint_at_depth(period, 1.0) == pytest.approx(left, rel=0.05)


@pytest.mark.parametrize(("shore", "modulus"), [(17.5, 0.645), (30.0, 1.142)])
def test_modulus_of_rubber_follows_gent(shore: float, modulus: float) -> None:
    """The two ends of the hardness range, in MPa."""
    assert modulus_of_shore(shore) == pytest.approx(modulus, abs=1e-3)
