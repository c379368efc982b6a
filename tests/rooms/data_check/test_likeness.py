"""Promise: frames of one press in two parts are found, different presses and equal images are not."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from small_recordings import loaded, save_arrays, simulated

from tacevo.choices import SensorTask
from tacevo.data.dataset import Dataset
from tacevo.data.survey import nearly_equal


def presses(count: int, size: int = 24) -> npt.NDArray[np.float64]:
    """Make images of different presses: smooth, and nothing alike."""
    rng = np.random.default_rng(0)
    coarse = rng.uniform(40, 200, (count, size // 4, size // 4))
    return coarse.repeat(4, axis=1).repeat(4, axis=2)


def framed(path: Path, frames: int, noise: float, *, groups: bool = False) -> Dataset:
    """Load 60 images, of which so many at a time are of one press and differ by noise."""
    rng = np.random.default_rng(1)
    images = presses(60 // frames).repeat(frames, axis=0)
    noisy = (images + rng.normal(0, noise, images.shape)).clip(0, 255).astype(np.uint8)
    known = np.arange(60) // frames if groups else None
    source = save_arrays(path / "a.npz", images=noisy, labels=np.linspace(0, 1, 60), groups=known)
    return loaded(source, path / "cache", held_out=(0.1, 0.2))


@pytest.mark.parametrize("noise", [0.5, 2.0, 5.0])
def test_frames_of_a_press_in_two_parts_are_found(tmp_path: Path, noise: float) -> None:
    """Each with one of its press in an earlier part; where presses are kept together, none is found."""
    dataset = framed(tmp_path / "torn", 3, noise)
    pairs = nearly_equal(dataset)
    held = {*dataset.validation.tolist(), *dataset.test.tolist()}
    assert pairs == tuple(sorted(dict(pairs).items()))
    assert all(row in held and row // 3 == other // 3 and row != other for row, other in pairs)
    train = {row // 3 for row in dataset.train.tolist()}
    assert {row for row in held if row // 3 in train} <= {row for row, _ in pairs}
    assert nearly_equal(framed(tmp_path / "whole", 3, noise, groups=True)) == ()


def test_different_presses_are_not_alike(tmp_path: Path) -> None:
    """Neither made-up ones nor those of the simulated sensor, of which many look alike."""
    assert nearly_equal(framed(tmp_path / "made", 1, 2.0)) == ()
    for task in SensorTask:
        assert nearly_equal(loaded(simulated(task, images=200, image_size=32, seed=0), tmp_path / task)) == ()


def test_equal_images_are_left_to_those_who_look_for_them(tmp_path: Path) -> None:
    """They are a leak of another kind; and of images that are all equal, none is nearer than others."""
    assert nearly_equal(framed(tmp_path / "equal", 3, 0.0)) == ()
    black = save_arrays(tmp_path / "b.npz", images=np.zeros((12, 16, 16), np.uint8))
    assert nearly_equal(loaded(black, tmp_path / "cache")) == ()


def test_large_parts_are_looked_at_in_even_steps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The time is bounded, and what is found is true."""
    dataset = framed(tmp_path, 3, 1.0)
    every = nearly_equal(dataset)
    monkeypatch.setattr("tacevo.data.survey._MOST", 20)
    some = nearly_equal(dataset)
    assert 0 < len(some) <= len(every)
    assert all(row // 3 == other // 3 for row, other in some)
