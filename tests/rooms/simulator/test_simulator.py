"""The simulated tasks: seeded image by image, physically plausible, the same bytes on every CPU, and learnable."""

import hashlib
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from small_recordings import loaded, simulated
from test_data_portable import PLAINEST, require_plainest
from torch import nn

from tacevo.choices import LightScene, SensorTask, SimulatedSensor
from tacevo.data.ideal import WIDTH_ERROR, ideal_accuracy
from tacevo.data.simulator.portable import normal
from tacevo.data.simulator.sensor import Press, _marker_pixels, make_sensor
from tacevo.data.simulator.tasks import (
    DOME_STIFFNESS,
    FORCE_NOISE,
    HYSTERESIS,
    SHORE_LEVELS,
    _press,
    draw,
)
from tacevo.randomness import stream
from tacevo.records import Kind

SPACINGS = (0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0)
FORCE = simulated(images=200, image_size=32, seed=0, spacings_mm=SPACINGS)

#: Of three images and all labels of each task at 64 pixels; other bytes would be another simulator version.
DIGEST = "498325093dd733d73c5a3de77afd1b2afd5dd220eaefa91814b81dca26baea2a"


def drawn_bytes() -> str:
    """Hash a few pictures and all labels of every task and light."""
    digest = hashlib.sha256()
    for task in SensorTask:
        for light in LightScene:
            source = replace(FORCE, task=task, light=light, image_size=64, sensor_seed=1)
            digest.update(source.catalogue().labels.tobytes())
            for index in (0, 77, 199):
                digest.update(draw(source, index).tobytes())
    return digest.hexdigest()


@pytest.mark.parametrize(("task", "size"), list(zip(SensorTask, (16, 45, 256), strict=True)))
def test_every_task_draws_at_every_size(task: SensorTask, size: int) -> None:
    """A picture is uint8, channels first, dark in the corners and bright in the middle."""
    image = draw(replace(FORCE, task=task, image_size=size), 3)
    middle = image[:, size // 4 : -size // 4, size // 4 : -size // 4]
    assert image.shape == (3, size, size)
    assert image.dtype == np.uint8
    assert image[:, 0, 0].max() < 30
    assert 90 < middle.mean() < 230


@pytest.mark.parametrize("task", SensorTask)
def test_kinds_of_sensors_see_markers_the_object_or_both(task: SensorTask) -> None:
    """The presses and their labels are the same; a kind is named where it is not the usual one."""
    both = replace(FORCE, task=task, image_size=64)
    kinds = {kind: replace(both, sensor=kind) for kind in SimulatedSensor}
    labels = {source.catalogue().labels.tobytes() for source in kinds.values()}
    pictures = {kind: draw(source, 3)[1].astype(float) for kind, source in kinds.items()}
    assert len(labels) == 1
    assert len({str(source.describe()) for source in kinds.values()}) == 3
    assert kinds[SimulatedSensor.ViTacTip].describe() == both.describe()
    assert pictures[SimulatedSensor.ViTac].mean() > 1.05 * pictures[SimulatedSensor.ViTacTip].mean()  # markers are dark
    assert np.abs(pictures[SimulatedSensor.TacTip] - pictures[SimulatedSensor.ViTacTip]).max() > 15


@pytest.mark.few(3)
@pytest.mark.parametrize("task", SensorTask)
@pytest.mark.parametrize("sensor", SimulatedSensor)
def test_gel_changes_what_is_seen_and_no_label(task: SensorTask, sensor: SimulatedSensor) -> None:
    """So sensors differ by it alone; no gel is what was there before the setting, in the cache's key, too."""
    bare = replace(FORCE, task=task, sensor=sensor, image_size=64)
    gels = [bare, *(replace(bare, gel_mm=gel) for gel in (0.5, 2.0))]
    assert len({source.catalogue().labels.tobytes() for source in gels}) == 1
    assert len({draw(source, 3).tobytes() for source in gels}) == len({str(source.describe()) for source in gels}) == 3
    assert replace(bare, gel_mm=0.0).describe() == bare.describe()
    assert "gel" not in str(bare.describe())


def test_gel_stands_in_the_facts(tmp_path: Path) -> None:
    """A run says what its sensor had on; one without says nothing, as runs of before the setting."""
    bare, gelled = (loaded(replace(FORCE, gel_mm=gel), tmp_path).facts for gel in (0.0, 1.5))
    assert (bare.selected, gelled.selected) == ((), ("data.gel_mm=1.5",))
    assert bare.fingerprint != gelled.fingerprint


@pytest.mark.parametrize("task", [SensorTask.force, SensorTask.hardness])
def test_image_depends_on_its_index_and_not_on_the_others(task: SensorTask) -> None:
    """Drawing in another order, or a larger data set, gives the same picture and label."""
    source = replace(FORCE, task=task)
    larger = replace(source, images=300)
    draw(source, 7)
    assert np.array_equal(draw(larger, 3), draw(source, 3))
    assert np.array_equal(source.catalogue().labels, larger.catalogue().labels[:200])


def test_larger_grating_set_begins_each_class_with_the_same_images() -> None:
    """Images stand class by class, and their number within the class decides them."""
    source = replace(FORCE, task=SensorTask.grating, images=7 * 4)
    larger = replace(source, images=7 * 6)
    for kind in (0, 6):
        assert np.array_equal(draw(source, 4 * kind + 2), draw(larger, 6 * kind + 2))


@pytest.mark.parametrize("change", [{"seed": 1}, {"sensor_seed": 1}, {"light": LightScene.side}])
def test_seeds_and_light_change_the_images(change: dict[str, Any]) -> None:
    """The cache knows them apart; sensor and light change what is seen, not what happened: the labels are equal."""
    other = replace(FORCE, **change)
    assert not np.array_equal(draw(FORCE, 0), draw(other, 0))
    assert FORCE.describe() != other.describe()
    assert np.array_equal(other.catalogue().labels, FORCE.catalogue().labels) == ("seed" not in change)


def test_bytes_are_those_of_every_machine() -> None:
    """The digest stands in this file, so another CPU or NumPy that gave other bytes would show."""
    assert drawn_bytes() == DIGEST


def printed_digest(*emulator: str, before: str = "pass", **variables: str) -> str:
    """Draw in a process of its own, after another statement; give what it prints."""
    script = f"import test_simulator as t; {before}; print(t.drawn_bytes())"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **variables}
    command = [*emulator, sys.executable, "-W", "ignore", "-c", script]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.slow
def test_plainest_loops_of_numpy_draw_the_same_bytes() -> None:
    """Without AVX, NumPy takes other machine code for every operation."""
    assert printed_digest(before=f"t.{require_plainest.__name__}()", **PLAINEST) == DIGEST


@pytest.mark.long
@pytest.mark.parametrize("cpu", ["Haswell", "EPYC-Milan", "Skylake-Server"])
def test_another_cpu_draws_the_same_bytes(cpu: str) -> None:
    """Emulated CPUs, whose mathematics library also takes other paths."""
    emulator = shutil.which("qemu-x86_64")
    if emulator is None:
        pytest.skip("qemu-x86_64 is not installed")
    assert printed_digest(emulator, "-cpu", cpu) == DIGEST


def test_forces_obey_friction_and_press_inwards() -> None:
    """Fz is compressive, and shear stays below friction except for the force sensor's noise (six deviations)."""
    fx, fy, fz = FORCE.catalogue().labels.T
    noise = 6 * FORCE_NOISE
    assert -2.8 < fz.min() < -1.5
    assert fz.max() < noise
    assert (np.hypot(fx, fy) <= 0.66 * (np.abs(fz) + noise) + 2**0.5 * noise).all()
    assert np.abs([fx.mean(), fy.mean()]).max() < 0.15


@pytest.mark.parametrize(("images", "counts"), [(700, [100] * 7), (11, [2] * 4 + [1] * 3)])
def test_gratings_are_as_even_over_classes_as_they_can_be(images: int, counts: list[int]) -> None:
    """Class by class; where the images are not a multiple of the classes, the first ones have one more."""
    catalogue = replace(FORCE, task=SensorTask.grating, images=images).catalogue()
    assert catalogue.kind is Kind.classification
    assert catalogue.labels.tolist() == np.repeat(range(7), counts).tolist()
    assert catalogue.names[:2] == ("0.5 mm", "0.75 mm")


def test_readings_are_the_press_with_the_stated_errors() -> None:
    """What the label differs by from the forces of that very contact is noise and hysteresis, the stated floor."""
    presses = [_press(FORCE, index)[:2] for index in range(FORCE.images)]
    truth = np.array([forces(press) for press, _ in presses])
    readings = np.array([label for _, label in presses])
    leans = np.array([press.lean for press, _ in presses])
    assert leans * DOME_STIFFNESS == pytest.approx(
        truth[:, :2], abs=1e-6
    )  # the dome carries what the contact transmits
    errors = (readings - truth) / np.sqrt(FORCE_NOISE**2 + (HYSTERESIS * truth) ** 2)
    assert np.abs(errors.mean(axis=0)).max() < 0.25
    assert errors.std(axis=0) == pytest.approx(1.0, rel=0.15)


def forces(press: Press) -> tuple[float, float, float]:
    """Work out a contact's forces in N from its geometry alone: Hertz, then Mindlin's Q = mu F (1 - (c/a)^3)."""
    radius = 4.0 * 38.0 / 42.0
    modulus = 0.14 / (1 + 0.5 * (press.x**2 + press.y**2) / 15**2)
    pressed = 4 / 3 * modulus / (1 - 0.49**2) * press.contact_radius**3 / radius
    dragged = 0.66 * pressed * (1 - (press.stick_radius / press.contact_radius) ** 3)
    along = np.array(press.slip_limit) / np.hypot(*press.slip_limit)
    return dragged * along[0], dragged * along[1], -pressed


@pytest.mark.parametrize("task", [SensorTask.grating, SensorTask.hardness])
def test_every_task_has_a_little_shear(task: SensorTask) -> None:
    """No press is upright: each slips at its edge and leans, both in the same direction."""
    source = replace(FORCE, task=task)
    for press in (_press(source, index)[0] for index in range(30)):
        assert 0 <= press.stick_radius < press.contact_radius
        lean, slid = np.array(press.lean), np.array(press.slip_limit)
        assert lean @ slid == pytest.approx(np.hypot(*lean) * np.hypot(*slid))
        assert 0 < np.hypot(*lean) < 1


def test_force_to_the_right_moves_the_markers_to_the_right() -> None:
    """The largest Fx of the set is seen as the picture's markers at the contact, shifted along the columns."""
    presses = [_press(FORCE, index)[:2] for index in range(FORCE.images)]
    press, label = max(presses, key=lambda pair: pair[1][0])
    sensor = make_sensor(256, 0)
    columns, rows, _ = _marker_pixels(sensor, press)
    rest, rest_rows, _ = _marker_pixels(sensor, replace(press, stick_radius=press.contact_radius, lean=(0.0, 0.0)))
    near = np.hypot(sensor.marker_x - press.x, sensor.marker_y - press.y) < press.contact_radius
    assert (columns - rest)[near].mean() > 2
    assert abs((rows - rest_rows)[near].mean()) < (columns - rest)[near].mean()
    assert label[0] > abs(label[1])


def test_harder_rubber_leaves_more_of_the_approach_to_the_sensor() -> None:
    """The share is E_o / (E_s + E_o) for equal Poisson's ratios: 0.423 at Shore 17.5 and 0.565 at 30."""
    source = replace(FORCE, task=SensorTask.hardness)
    shares = {label[0]: press.share for press, label, _ in (_press(source, index) for index in range(source.images))}
    assert sorted(shares) == list(SHORE_LEVELS)
    assert [shares[level] for level in SHORE_LEVELS] == sorted(shares.values())
    assert shares[17.5] == pytest.approx(0.423, abs=0.002)
    assert shares[30.0] == pytest.approx(0.565, abs=0.002)


def test_wider_grooves_are_darker_and_imprint_deeper() -> None:
    """Every plate is wider than its contact, and the skin closes none of its grooves."""
    source = replace(FORCE, task=SensorTask.grating, images=70)
    presses = [_press(source, index)[0] for index in range(source.images)]
    gratings = [press.grating for press in presses if press.grating is not None]
    grooves = [grating.groove for grating in gratings[::10]]
    assert grooves == sorted(grooves, reverse=True)
    assert np.mean([grating.imprint for grating in gratings[-10:]]) > 2 * gratings[0].imprint
    for press, grating in zip(presses, gratings, strict=True):
        assert grating.side > 2 * press.contact_radius
        assert 0 < grating.imprint < 2 / np.pi * 0.5


def test_ridges_and_their_brightness_err_as_stated() -> None:
    """Widths differ by 3 % from their class's, a contact is 60 +- 6 grey values bright, and a plate keeps out 50."""
    source = replace(FORCE, task=SensorTask.grating, images=700)
    sampled = [_press(source, index)[:2] for index in range(source.images)]
    pairs = [(press, press.grating) for press, _ in sampled if press.grating is not None]
    spacings = np.array([SPACINGS[int(label[0])] for _, label in sampled])
    widths = np.array([grating.period / 2 for _, grating in pairs])
    bright = np.array([press.brightness for press, _ in pairs])
    grooves = bright * [grating.groove for _, grating in pairs]
    assert np.mean(widths / spacings) == pytest.approx(1, abs=0.005)
    assert np.std(widths / spacings) == pytest.approx(0.03, rel=0.1)
    assert (bright.mean(), bright.std()) == (pytest.approx(60, abs=1), pytest.approx(6, rel=0.1))
    assert grooves == pytest.approx((bright + 50) * np.exp(-widths) - 50)


@pytest.mark.parametrize(("ratio", "by_hand"), [(1.12, 0.9499), (1.5, 1.0)])
def test_ideal_accuracy_is_that_of_an_observer_of_drawn_widths(ratio: float, by_hand: float) -> None:
    """Of 1,400 presses, whose widths are named by the likeliest class; steps of 12 % leave 5 % of them to chance."""
    spacings = tuple(0.5 * ratio**step for step in range(7))
    source = replace(simulated(SensorTask.grating, images=1400), spacings_mm=spacings)
    presses = [_press(source, index) for index in range(source.images)]
    widths = np.array([press.grating.period / 2 for press, _, _ in presses if press.grating is not None])
    means = np.array(spacings)
    unlikely = np.log(means) + ((widths[:, None] - means) / (WIDTH_ERROR * means)) ** 2 / 2
    right = np.mean(unlikely.argmin(axis=1) == np.array([label for _, (label,), _ in presses]))
    assert ideal_accuracy(spacings[::-1]) == pytest.approx(by_hand, abs=1e-4)
    assert right == pytest.approx(by_hand, abs=3 * np.sqrt(by_hand * (1 - by_hand) / source.images) + 1e-4)


def test_ceiling_of_the_default_spacings() -> None:
    """Drawn directly: 99.49 %, to a tenth of a point."""
    means = np.array([0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0])
    widths = means * (1 + normal(np.random.default_rng(0), WIDTH_ERROR, (20_000, 7)))
    unlikely = np.log(means) + ((widths[:, :, None] - means) / (WIDTH_ERROR * means)) ** 2 / 2
    assert ideal_accuracy(means.tolist()) == pytest.approx(np.mean(unlikely.argmin(axis=2) == np.arange(7)), abs=1e-3)
    assert ideal_accuracy(means.tolist()) == pytest.approx(0.99487, abs=1e-5)


def test_spacings_matter_to_gratings_only() -> None:
    """Another list of spacings is another grating data set, but the same force data set."""
    grating = replace(FORCE, task=SensorTask.grating)
    assert replace(FORCE, spacings_mm=(1.0,)).describe() == FORCE.describe()
    assert replace(grating, spacings_mm=(1.0, 2.0)).describe() != grating.describe()


@pytest.mark.slow
def test_baseline_learns_small_forces(tmp_path: Path) -> None:
    """Within 8 epochs of 480 images at 32 pixels the validation error falls clearly below the labels' variance."""
    dataset = loaded(replace(FORCE, images=600), tmp_path)
    mean, deviation = (torch.tensor(values)[:, None, None] for values in (dataset.mean, dataset.deviation))
    inputs = (torch.from_numpy(np.load(dataset.images)).float() - mean) / deviation
    targets, rows = torch.from_numpy(dataset.targets), torch.from_numpy(dataset.validation)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        blocks = [
            layer
            for channels, width in ((3, 32), (32, 64), (64, 128))
            for layer in (nn.Conv2d(channels, width, 3, padding=1), nn.ReLU(), nn.MaxPool2d(2))
        ]
        network = nn.Sequential(*blocks, nn.Flatten(), nn.Linear(2048, 512), nn.ReLU(), nn.Linear(512, 3))
        optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
        for epoch in range(8):
            for batch in np.array_split(stream(0, "order", epoch).permutation(dataset.train), 15):
                optimiser.zero_grad()
                nn.functional.mse_loss(network(inputs[batch]), targets[batch]).backward()  # type: ignore[no-untyped-call]
                optimiser.step()
        with torch.no_grad():
            error = float(nn.functional.mse_loss(network(inputs[rows]), targets[rows]))
    assert error < 0.7 * dataset.targets[dataset.validation].var(axis=0).mean()
