"""Promise: images that use little of their range, and files of several depths, are found; others are not suspected."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from small_recordings import loaded, save_arrays, save_deep_colour

from tacevo.data.exposure import doubtful_images
from tacevo.data.sources.table import TableSource
from tacevo.parts.source import Source


def noise(most: int, kind: type = np.uint16) -> list[np.typing.NDArray[Any]]:
    """Make twenty images whose values are spread from 0 to the largest."""
    rng = np.random.default_rng(1)
    images: list[np.typing.NDArray[Any]] = [rng.integers(0, most + 1, (16, 16)).astype(kind) for _ in range(20)]
    images[7][3, 3] = most
    return images


def save(root: Path, images: list[np.typing.NDArray[Any]]) -> TableSource:
    """Write images and a table."""
    root.mkdir(exist_ok=True)
    for number, image in enumerate(images):
        Image.fromarray(image).save(root / f"{number:02d}.png")
    rows = "".join(f"{number:02d}.png,{number}\n" for number in range(len(images)))
    (root / "labels.csv").write_text(f"image,fx\n{rows}")
    return TableSource(root=root, table="labels.csv", image_column="image", target_columns=("fx",), image_size=16)


def doubts(source: Source, cache: Path) -> list[str]:
    """Load a data set; return what is doubtful in it."""
    return doubtful_images(source.catalogue(), loaded(source, cache))


@pytest.mark.parametrize(
    ("most", "kind", "white"),
    [
        (4000, np.uint16, 4095),
        (255, np.uint16, 255),
        (256, np.uint16, 511),
        (8191, np.uint16, 8191),
        (31, np.uint8, 31),
    ],
)
def test_images_that_use_little_of_their_range_are_told(tmp_path: Path, most: int, kind: type, white: int) -> None:
    """The largest value and the range are named; the setting that is offered ends the warning."""
    source = save(tmp_path / "recording", noise(most, kind))
    (warning,) = doubts(source, tmp_path / "cache")
    assert f"is {most} of {np.iinfo(kind).max}," in warning
    assert warning.endswith(f"set data.white_point={white}")
    assert doubts(replace(source, white_point=float(white)), tmp_path / "cache") == []


@pytest.mark.parametrize(("most", "kind"), [(8192, np.uint16), (65535, np.uint16), (32, np.uint8), (255, np.uint8)])
def test_images_that_use_more_are_not(tmp_path: Path, most: int, kind: type) -> None:
    """One pixel of one image beyond an eighth is enough, also where the small image has lost it."""
    images: list[np.typing.NDArray[Any]] = [
        np.kron(image // 8, np.ones((4, 4), kind)).astype(kind) for image in noise(most, kind)
    ]
    images[11][5, 5] = most
    assert doubts(save(tmp_path / "recording", images), tmp_path / "cache") == []


@pytest.mark.parametrize(
    ("most", "words"),
    [
        (1.0, "is 1 of 255, so that 2 of 256 grey levels are left: set data.white_point=1"),
        (0.0, "all images are black"),
    ],
)
def test_white_point_that_is_too_large_is_told_too(tmp_path: Path, most: float, words: str) -> None:
    """The range is then the one that the user named, of an archive as well; black images have no white."""
    images = np.random.default_rng(0).random((12, 16, 16)).astype(np.float32) * most
    images[0, 0, 0] = most
    (warning,) = doubts(replace(save_arrays(tmp_path / "a.npz", images=images), white_point=255.0), tmp_path / "cache")
    assert warning.endswith(words)


def test_colour_of_16_bits_has_another_remedy(tmp_path: Path) -> None:
    """No white point helps where the low bytes are not read."""
    source = save(tmp_path / "recording", noise(255, np.uint8))
    for number in range(20):
        save_deep_colour(tmp_path / "recording" / f"{number:02d}.png", 100 * number, size=16)
    (warning,) = doubts(source, tmp_path / "cache")
    assert "is 7 of 255, the high byte of 16 bits: save the images in grey" in warning
    assert "white_point" not in warning


def test_files_of_several_depths_are_named(tmp_path: Path) -> None:
    """One light gives two grey values there; the rarer ones are named."""
    images = noise(255, np.uint8)
    images[4] = images[4].astype(np.uint16) * 200
    (warning,) = doubts(save(tmp_path / "recording", images), tmp_path / "cache")
    assert "19 of 8 bits, 1 of 16 bits; not of 8: line 6 '04.png'" in warning
