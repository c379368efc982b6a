"""The simulated sensor: seeded image by image, physically plausible, looks like its model, and can be learnt."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import ndimage
from torch import nn

from tacevo.choices import Normalisation, TargetScaling
from tacevo.data.contact import Field
from tacevo.data.dataset import Dataset
from tacevo.data.loading import load
from tacevo.data.sensor import Grating, Press, make_sensor, picture
from tacevo.data.simulator import SHORE_LEVELS, Simulated, SimulatedTask, draw
from tacevo.errors import ConfigError
from tacevo.randomness import stream
from tacevo.records import Kind

SPACINGS = (0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0)
FORCE = Simulated(task=SimulatedTask.force, images=200, image_size=32, seed=0, spacings_mm=SPACINGS)
NO_CONTACT = Press(
    x=0.0, y=0.0, contact_radius=1e-3, radius=4.0, share=0.0, shear=(0.0, 0.0), brightness=0.0, fading=0.3
)


@pytest.mark.parametrize("task", SimulatedTask)
@pytest.mark.parametrize("size", [16, 48, 256])
def test_every_task_draws_at_every_size(task: SimulatedTask, size: int) -> None:
    """A picture is uint8, channels first, dark in the corners and bright in the middle."""
    image = draw(replace(FORCE, task=task, image_size=size), 3)
    middle = image[:, size // 4 : -size // 4, size // 4 : -size // 4]
    assert image.shape == (3, size, size)
    assert image.dtype == np.uint8
    assert image[:, 0, 0].max() < 30
    assert 90 < middle.mean() < 230


def test_image_depends_on_its_index_and_not_on_the_others() -> None:
    """Drawing in another order, or a larger data set, gives the same picture and label."""
    larger = replace(FORCE, images=300)
    backwards = [draw(FORCE, index) for index in (7, 3)]
    assert np.array_equal(draw(larger, 3), backwards[1])
    assert np.array_equal(FORCE.catalogue().labels, larger.catalogue().labels[:200])


@pytest.mark.parametrize("other", [replace(FORCE, seed=1), replace(FORCE, task=SimulatedTask.hardness)])
def test_seed_and_task_change_the_images(other: Simulated) -> None:
    """No two data sets share their draws."""
    assert not np.array_equal(draw(FORCE, 0), draw(other, 0))
    assert FORCE.describe() != other.describe()


def test_forces_obey_friction_and_press_inwards() -> None:
    """Fz is compressive, and shear stays below friction except for the sensor's noise (0.02 N, 5 deviations)."""
    fx, fy, fz = FORCE.catalogue().labels.T
    assert -2.8 < fz.min() < -1.5
    assert fz.max() < 0.1
    assert (np.hypot(fx, fy) <= 0.66 * np.abs(fz) + 0.2).all()
    assert np.abs([fx.mean(), fy.mean()]).max() < 0.15


def test_gratings_are_even_over_classes() -> None:
    """The paper's 3,507 images are 501 of each of 7 classes."""
    catalogue = Simulated(
        task=SimulatedTask.grating, images=3_507, image_size=16, seed=0, spacings_mm=SPACINGS
    ).catalogue()
    assert catalogue.kind is Kind.classification
    assert np.bincount(catalogue.labels).tolist() == [501] * 7
    assert catalogue.names[:2] == ("0.5 mm", "0.75 mm")


def test_hardness_has_six_levels() -> None:
    """Labels are those of six specimens."""
    labels = replace(FORCE, task=SimulatedTask.hardness).catalogue().labels
    assert set(np.unique(labels)) == set(SHORE_LEVELS)


def test_spacings_matter_to_gratings_only() -> None:
    """Another list of spacings is another grating data set, but the same force data set."""
    grating = replace(FORCE, task=SimulatedTask.grating)
    assert replace(FORCE, spacings_mm=(1.0,)).describe() == FORCE.describe()
    assert replace(grating, spacings_mm=(1.0, 2.0)).describe() != grating.describe()


@pytest.mark.parametrize("size", [0, 8, 40, 272])
def test_impossible_size_is_refused(size: int) -> None:
    """The message names the setting and the range."""
    with pytest.raises(ConfigError, match=rf"data.image_size .* multiple of 16 from 16 to 256; got {size}"):
        replace(FORCE, image_size=size)


@pytest.mark.parametrize("spacings", [(), (0.0, 1.0), (1.0, 1.0)])
def test_impossible_spacings_are_refused(spacings: tuple[float, ...]) -> None:
    """Classes need widths that exist and differ."""
    with pytest.raises(ConfigError, match=r"data.spacings_mm needs different widths"):
        replace(FORCE, task=SimulatedTask.grating, spacings_mm=spacings)


def clean(press: Press) -> Field:
    """Average the grey picture of a press over 20 draws of light and noise, at 256 pixels."""
    sensor = make_sensor(256, 0)
    total = np.zeros((256, 256))
    for number in range(20):
        total += picture(sensor, press, stream(0, "test", number))[1]
    return total / 20


def test_sensor_shows_127_dark_markers() -> None:
    """The markers of the untouched sensor can be counted as the dark blobs inside its rim."""
    image = clean(NO_CONTACT)
    inside = np.hypot(*(np.indices((256, 256)) - 127.5)) < 100
    _, count = ndimage.label((image < 0.7 * ndimage.median_filter(image, 21)) & inside)
    assert count == 127


def test_contact_brightens_its_own_place() -> None:
    """A press to the right (x = 5 mm) is seen to the right of the middle."""
    press = replace(NO_CONTACT, x=5.0, contact_radius=2.0, share=1.0, brightness=60.0)
    change = clean(press) - clean(NO_CONTACT)
    assert change[118:138, 150:172].mean() > 25
    assert abs(change[118:138, 60:100].mean()) < 10


def test_grating_shows_its_period() -> None:
    """The strongest frequency across ridges of 4 mm period is that of 4 mm at the middle of the picture."""
    grating = Grating(period=4.0, yaw=0.0, phase=0.0, contrast=1.0, imprint=0.0, side=16.0)
    flat = replace(NO_CONTACT, contact_radius=8.0, radius=38.0, brightness=60.0, fading=5.0)
    row = (clean(replace(flat, grating=grating)) - clean(flat))[100:156, 74:182].mean(axis=0)
    spectrum = np.abs(np.fft.rfft(row - row.mean(), 1080))
    pixels = 1080 / int(spectrum.argmax())
    assert pixels == pytest.approx(4.0 * 128 / 19, rel=0.1)


def test_baseline_learns_small_forces(tmp_path: Path) -> None:
    """Within 8 epochs of 480 images at 32 pixels the validation error falls clearly below the labels' variance."""
    dataset = load(
        replace(FORCE, images=600),
        split_seed=0,
        normalisation=Normalisation.standardise,
        target_scaling=TargetScaling.minmax,
        cache=tmp_path,
        workers=1,
    )
    variance = dataset.targets[dataset.validation].var(axis=0).mean()
    assert validation_error(dataset, epochs=8) < 0.7 * variance


def validation_error(dataset: Dataset, epochs: int) -> float:
    """Train a CNN as the paper's baseline (Adam 1e-3, batch 32); return its validation MSE."""
    mean, deviation = (torch.tensor(values)[:, None, None] for values in (dataset.mean, dataset.deviation))
    inputs = (torch.from_numpy(np.load(dataset.images)).float() - mean) / deviation
    targets = torch.from_numpy(dataset.targets)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        network = baseline(dataset.facts.outputs)
        optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
        for epoch in range(epochs):
            order = stream(0, "order", epoch).permutation(dataset.train)
            for start in range(0, len(order), 32):
                batch = torch.from_numpy(order[start : start + 32])
                optimiser.zero_grad()
                nn.functional.mse_loss(network(inputs[batch]), targets[batch]).backward()  # type: ignore[no-untyped-call]
                optimiser.step()
    rows = torch.from_numpy(dataset.validation)
    with torch.no_grad():
        return float(nn.functional.mse_loss(network.eval()(inputs[rows]), targets[rows]))


def baseline(outputs: int) -> nn.Sequential:
    """Build the paper's baseline: three convolutional blocks, adaptive pooling, one hidden layer of 512."""
    blocks = [
        layer
        for channels, width in ((3, 32), (32, 64), (64, 128))
        for layer in (nn.Conv2d(channels, width, 3, padding=1), nn.ReLU(), nn.MaxPool2d(2))
    ]
    head = (nn.AdaptiveAvgPool2d(4), nn.Flatten(), nn.Linear(2048, 512), nn.ReLU(), nn.Dropout(0.5))
    return nn.Sequential(*blocks, *head, nn.Linear(512, outputs))
