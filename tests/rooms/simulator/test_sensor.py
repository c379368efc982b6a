"""The simulated picture: it looks like a photograph of the real sensor, and shows what happens to the skin."""

from dataclasses import replace
from functools import cache

import numpy as np
import numpy.typing as npt
import pytest
from checkout import SHARED
from PIL import Image
from scipy import ndimage

from tacevo.choices import LightScene
from tacevo.data.simulator.contact import normal_field, shear_field, stick_radius
from tacevo.data.simulator.sensor import (
    Grating,
    Press,
    _below_gel,
    _bent_skin,
    _marker_cover,
    _marker_pixels,
    make_sensor,
    picture,
)
from tacevo.randomness import stream

#: The sensor at rest.
NO_CONTACT = Press(
    x=0.0,
    y=0.0,
    contact_radius=1e-6,
    radius=1.0,
    share=0.0,
    slip_limit=(0.0, 0.0),
    stick_radius=1e-6,
    lean=(0.0, 0.0),
    brightness=0.0,
    fading=1.0,
)

PHOTOGRAPH = (
    SHARED / "data" / "vitactip_photos" / "vitactip_photo_default_state_1920_1080.jpg"
)  # of a real ViTacTip at rest

Grey = npt.NDArray[np.float64]


@cache
def clean(press: Press, scene: LightScene = LightScene.standard, gel: float = 0.0) -> Grey:
    """Average the grey picture of a press over 20 draws of light and noise, at 256 pixels."""
    sensor = make_sensor(256, 0, gel)
    pictures = [picture(sensor, press, stream(0, "test", number), scene)[1] for number in range(20)]
    return np.asarray(np.mean(pictures, axis=0))


def markers(grey: Grey) -> tuple[Grey, Grey]:
    """Find the dark blobs on the dome: centres (N, 2) and areas (N,), in pixels of a 256 pixel image."""
    around = ndimage.median_filter(grey, 21)
    darker = around - grey
    inside = np.hypot(*(np.indices((256, 256)) - 127.5)) < 100
    labels, count = ndimage.label((darker > 0.21 * np.maximum(around, 40)) & inside)
    numbers = np.arange(1, count + 1)
    areas = ndimage.sum_labels(np.ones_like(grey), labels, numbers)
    centres = np.array(ndimage.center_of_mass(darker, labels, numbers))
    return centres[areas > 8], areas[areas > 8]


def neighbour_distance(centres: Grey) -> float:
    """Median distance between neighbours, over the six nearest of every inner marker."""
    distances = np.sort(np.hypot(*(centres[:, None] - centres).transpose(2, 0, 1)), axis=1)
    inner = np.hypot(*(centres - centres.mean(axis=0)).T) < 50
    return float(np.median(distances[inner, 1:7]))


def moves(before: Press, after: Press) -> tuple[Grey, Grey]:
    """Follow every marker from one press to another: its place (127, 2) from the middle, and its move (127, 2)."""
    start, end = (places(press) for press in (before, after))
    return start - 127.5, end - start


def places(press: Press) -> Grey:
    """Find the row and column of every marker, (127, 2), in pixels of a 256 pixel image."""
    columns, rows, _ = _marker_pixels(make_sensor(256, 0), press)
    return np.stack([rows, columns], axis=1)


def extent(centres: Grey) -> float:
    """Mean distance of the hexagon's six corners from its middle."""
    return float(np.sort(np.hypot(*(centres - centres.mean(axis=0)).T))[-6:].mean())


def profile(grey: Grey) -> Grey:
    """Median brightness in rings around the middle, relative to the innermost."""
    distance = np.hypot(*(np.indices((256, 256)) - 127.5))
    rings = [np.median(grey[np.abs(distance - radius) < 3]) for radius in (6, 36, 60, 96, 108, 127)]
    return np.asarray(np.array(rings) / rings[0])


def test_sensor_at_rest_looks_like_a_photograph_of_the_real_one() -> None:
    """127 markers, 13 pixels apart and 81 out, as in the photograph; brightness falls towards the rim alike."""
    drawn = clean(NO_CONTACT)
    centres, areas = markers(drawn)
    assert len(centres) == 127
    assert neighbour_distance(centres) == pytest.approx(13.0, rel=0.05)
    assert extent(centres) == pytest.approx(81.0, rel=0.05)
    assert np.median(areas) == pytest.approx(26, abs=5)
    if not PHOTOGRAPH.exists():
        pytest.skip("the photographs are not here")
    with Image.open(PHOTOGRAPH) as file:
        real = np.asarray(file.convert("L").resize((256, 256), Image.Resampling.BOX), dtype=np.float64)
    real_centres, real_areas = markers(real)
    assert len(centres) == len(real_centres)
    assert neighbour_distance(centres) == pytest.approx(neighbour_distance(real_centres), rel=0.05)
    assert extent(centres) == pytest.approx(extent(real_centres), rel=0.05)
    assert np.median(areas) == pytest.approx(np.median(real_areas), rel=0.2)
    assert profile(drawn) == pytest.approx(profile(real), abs=0.12)


@pytest.mark.parametrize("size", [128, 32])
def test_small_picture_is_the_large_one_averaged(size: int) -> None:
    """Markers, contact and grain of a small image are those of 256 pixels, resized."""
    press = replace(NO_CONTACT, x=3.0, contact_radius=2.5, radius=3.6, share=1.0, brightness=60.0, fading=0.3)
    large, small = (
        picture(make_sensor(pixels, 0), press, stream(0, "test"), LightScene.standard)[1].astype(np.float64)
        for pixels in (256, size)
    )
    block = 256 // size
    averaged = large.reshape(size, block, size, block).mean(axis=(1, 3))
    inside = np.hypot(*(np.indices((size, size)) - (size - 1) / 2)) < 0.45 * size
    difference = (small - averaged)[inside]
    assert abs(difference.mean()) < 1.5
    assert difference.std() < 0.35 * averaged[inside].std()


def test_markers_cover_as_much_at_every_size() -> None:
    """Neither the soft edge nor the pixels make small markers larger."""
    covers = [_marker_cover(make_sensor(size, 0), NO_CONTACT, stream(0, "test")).mean() for size in (256, 128, 64, 32)]
    assert covers == pytest.approx([covers[0]] * 4, rel=0.03)
    assert covers[0] == pytest.approx(127 * np.pi * 2.75**2 / 256**2, rel=0.03)


def test_markers_grow_as_they_come_nearer() -> None:
    """A millimetre of lift makes a marker 3 % wider."""
    lifted = replace(NO_CONTACT, contact_radius=30.0, radius=900.0, share=1.0)  # the whole skin, by 1 mm at the middle
    rest, near = (_marker_cover(make_sensor(256, 0), press, stream(0, "test")).sum() for press in (NO_CONTACT, lifted))
    assert 1.02 < near / rest < 1.06


def test_skin_is_held_at_the_rim() -> None:
    """The displacement falls from a half-space's at the middle to nothing at the rim, and its gradient is its own."""
    press = replace(NO_CONTACT, x=4.0, y=-3.0, contact_radius=2.5, radius=3.6, share=1.0)
    x, y, step = np.array([4.0, 9.0, 20.0, 2.0]), np.array([-3.0, 1.0, 0.0, -6.0]), 1e-4
    lift, (slope_x, slope_y) = _bent_skin(press, x, y)
    free, _ = normal_field(np.maximum(np.hypot(x - 4.0, y + 3.0), 1e-6), 2.5, 3.6)
    assert lift == pytest.approx(free * (1 - (x**2 + y**2) / 400))
    for slope, right, down in ((slope_x, step, 0.0), (slope_y, 0.0, step)):
        ahead, behind = (_bent_skin(press, x + side * right, y + side * down)[0] for side in (1, -1))
        assert slope[[1, 3]] == pytest.approx((ahead - behind)[[1, 3]] / (2 * step), rel=1e-4, abs=1e-6)


def test_gel_spreads_a_press_and_keeps_its_force() -> None:
    """The skin below bends less at the middle and more beside it, and far away as much as without, in every way."""
    press = replace(NO_CONTACT, contact_radius=2.0, radius=3.6, share=1.0, slip_limit=(1.0, 0.5), stick_radius=1.0)
    below = _below_gel(press, 2.0)
    distance = np.array([0.01, 3.5, 60.0])
    bare, spread = (normal_field(distance, one.contact_radius, one.radius)[0] for one in (press, below))
    sheared, apart = (
        shear_field(
            distance, 0 * distance, one.contact_radius, stick=one.stick_radius, limit=one.slip_limit, poisson=0.49
        )
        for one in (press, below)
    )
    for plain, gelled in ((bare, spread), (sheared[0], apart[0])):
        assert gelled[0] < 0.75 * plain[0]
        assert gelled[2] == pytest.approx(plain[2], rel=2e-3)
    assert spread[1] / spread[0] > 1.2 * bare[1] / bare[0]
    assert _below_gel(press, 0.0) == press


@pytest.mark.parametrize("gel", [1.0, 3.0])
def test_gel_blurs_fine_gratings_before_coarse_ones(gel: float) -> None:
    """Each loses contrast with the thickness, in the picture and in its markers' tilt, and a fine one loses all."""

    def contrast(period: float, thickness: float) -> float:
        grating = Grating(period=period, across=(1.0, 0.0), phase=0.0, groove=0.0, imprint=0.0, side=16.0)
        flat = replace(NO_CONTACT, contact_radius=8.0, radius=38.0, brightness=60.0, fading=5.0)
        ridged = clean(replace(flat, grating=grating), gel=thickness) - clean(flat, gel=thickness)
        return float(ridged[100:156, 74:182].mean(axis=0).std())

    left = {period: contrast(period, gel) / contrast(period, 0.0) for period in (1.5, 4.0)}
    assert left[1.5] < 0.75 * left[4.0] < 0.75


def test_gel_widens_what_is_seen_of_a_ball() -> None:
    """Beside the contact the light of a touching ball reaches further; on the contact it is as bright."""
    press = replace(NO_CONTACT, contact_radius=2.0, radius=4.0, brightness=60.0, fading=0.3)
    bare, gelled = (clean(press, gel=gel) - clean(NO_CONTACT, gel=gel) for gel in (0.0, 3.0))
    place = np.hypot(*(make_sensor(256, 0).x, make_sensor(256, 0).y))
    assert gelled[place < 1.8].mean() == pytest.approx(bare[place < 1.8].mean(), rel=0.02)
    beside = (place > 2.6) & (place < 3.4)
    assert gelled[beside].mean() > 1.3 * bare[beside].mean()


def test_contact_fades_with_the_gap() -> None:
    """Outside the contact the object is seen as exp(-gap / l), with gap = (r^2 - a^2) / 2R."""
    press = replace(NO_CONTACT, contact_radius=2.0, radius=4.0, brightness=60.0, fading=0.3)
    row = (clean(press) - clean(NO_CONTACT))[126:130].mean(axis=0)
    sensor = make_sensor(256, 0)
    distance = np.abs(sensor.x[127])
    expected = 60 * np.exp(-np.maximum(distance**2 - 4, 0) / 8 / 0.3)
    bare = (_marker_cover(sensor, NO_CONTACT, stream(0, "test"))[126:130].max(axis=0) < 0.02) & (distance < 8)
    assert bare.sum() > 30
    assert row[bare] == pytest.approx(expected[bare], abs=5)


def test_slopes_towards_the_light_are_brighter() -> None:
    """The light shades a dent: the flank that falls towards it is dark, the one that rises is bright."""
    dent = replace(NO_CONTACT, contact_radius=2.5, radius=3.6, share=1.0)
    change = clean(dent) - clean(NO_CONTACT)
    assert change[100:156, 96:116].mean() > 3
    assert change[100:156, 140:160].mean() < -3


def test_markers_are_seen_where_they_are() -> None:
    """Of a press that bends, shears and leans, the picture has each of them within a pixel of its place."""
    stick = stick_radius(0.5, 2.0, 3.0)
    press = replace(NO_CONTACT, contact_radius=3.0, radius=5.0, share=0.5, slip_limit=(2.0, 1.0), stick_radius=stick)
    seen, _ = markers(clean(replace(press, lean=(1.0, -0.5))))
    there = places(replace(press, lean=(1.0, -0.5)))
    assert len(seen) == 127
    assert np.hypot(*(seen[:, None] - there).transpose(2, 0, 1)).min(axis=1).max() < 1


def test_pins_splay_outwards_around_a_press() -> None:
    """The skin's slope tilts the pins, so a press at the middle widens the ring of markers around it."""
    pressed = replace(NO_CONTACT, contact_radius=1.9, radius=3.6, share=1.0)
    place, move = moves(NO_CONTACT, pressed)
    distance = np.hypot(*place.T)
    ring = (distance > 8) & (distance < 20)
    assert ((move * place).sum(axis=1) / distance)[ring].min() > 0.5


def test_sideways_push_carries_the_markers_along() -> None:
    """0.5 mm of shear moves the markers under the contact by that, 3.4 pixels, and those at the rim hardly."""
    pushed = replace(NO_CONTACT, contact_radius=3.0, slip_limit=(2.0, 0.0), stick_radius=stick_radius(0.5, 2.0, 3.0))
    place, move = moves(NO_CONTACT, pushed)
    distance = np.hypot(*place.T)
    assert np.median(move[distance < 10, 1]) == pytest.approx(3.4, abs=0.3)
    assert np.median(move[distance > 75, 1]) < 0.7
    assert np.abs(np.median(move[:, 0])) < 0.1


def test_leaning_dome_carries_every_marker_but_those_at_its_rim() -> None:
    """1 mm of lean moves the middle by that, 6.8 pixels, three quarters of it half-way out, and nothing at the rim."""
    place, move = moves(NO_CONTACT, replace(NO_CONTACT, lean=(1.0, 0.0)))
    distance = np.hypot(*place.T)
    assert np.median(move[distance < 10, 1]) == pytest.approx(6.8, abs=0.3)
    half_way = (distance > 55) & (distance < 75)
    assert np.median(move[half_way, 1]) == pytest.approx(0.75 * 6.8, abs=0.7)
    assert np.abs(np.median(move[:, 0])) < 0.1


@pytest.mark.parametrize("period", [1.5, 2.5, 4.0])
def test_grating_shows_its_period(period: float) -> None:
    """The strongest frequency across the ridges is that of the period at the middle of the picture."""
    grating = Grating(period=period, across=(1.0, 0.0), phase=0.0, groove=0.0, imprint=0.0, side=16.0)
    flat = replace(NO_CONTACT, contact_radius=8.0, radius=38.0, brightness=60.0, fading=5.0)
    row = (clean(replace(flat, grating=grating)) - clean(flat))[100:156, 74:182].mean(axis=0)
    spectrum = np.abs(np.fft.rfft(row - row.mean(), 1080))
    assert 1080 / int(spectrum.argmax()) == pytest.approx(period * 128 / 19, rel=0.1)


def test_coarse_imprint_tilts_the_markers_of_its_plate_and_a_fine_one_none() -> None:
    """A groove of 4 mm period reaches the pins through the skin, one of 1 mm does not; beside the plate none moves."""
    flat = replace(NO_CONTACT, contact_radius=8.0, radius=38.0)

    def moved(period: float) -> tuple[float, float]:
        grating = Grating(period=period, across=(1.0, 0.0), phase=0.1, groove=1.0, imprint=0.2, side=6.0)
        place, move = moves(flat, replace(flat, grating=grating))
        lengths, outside = np.hypot(*move.T), np.abs(place).max(axis=1) > 4.5 * 6.7
        return float(lengths[~outside].max()), float(lengths[outside].max())

    assert moved(4.0)[0] > 1
    assert moved(1.0)[0] < 0.4
    assert moved(4.0)[1] < 0.3


def test_light_scenes_differ_as_named() -> None:
    """Dim is darker, bright is brighter, and light from the side is uneven."""
    standard, dim, bright, side = (clean(NO_CONTACT, scene) for scene in LightScene)
    middle = np.s_[88:168, 88:168]
    assert dim[middle].mean() == pytest.approx(0.7 * standard[middle].mean(), rel=0.02)
    assert bright[middle].mean() == pytest.approx(1.25 * standard[middle].mean(), rel=0.02)
    ratio = side / np.maximum(standard, 1)
    assert ratio[118:138, 190:210].mean() > 1.1
    assert ratio[118:138, 46:66].mean() < 0.9
