"""Promise: a white point keeps the grey levels of values that use few bits, and is refused where it would lie."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from refusals import refused
from small_recordings import loaded, save_arrays, save_deep_colour, save_table

from tacevo.data.sources.image_files import decode, to_8_bits
from tacevo.data.sources.table import TableSource
from tacevo.errors import DataError


def ramp(most: int) -> np.typing.NDArray[np.uint16]:
    """Return 16 x 16 values that rise from 0 to the largest."""
    return np.linspace(0, most, 256).round().astype(np.uint16).reshape(16, 16)


def save_ramps(root: Path, most: int) -> TableSource:
    """Write a table and images of 16 bits whose values go up to the largest."""
    source = save_table(root, "".join(f"{number}.png,{number},{number % 3},\n" for number in range(12)))
    for number in range(12):
        Image.fromarray(ramp(most)).save(root / f"{number}.png")
    return source


@pytest.mark.parametrize("bits", [8, 12, 14])
def test_values_of_few_bits_keep_their_grey_levels(tmp_path: Path, bits: int) -> None:
    """A camera of 12 bits in files of 16 has 17 levels without, and all 256 with its own white."""
    source = save_ramps(tmp_path, 2**bits - 1)
    with_white = replace(source, white_point=2.0**bits - 1)
    levels = [len(np.unique(each.catalogue().pictures[0]())) for each in (source, with_white)]
    assert levels == [2 ** (bits - 8) + 1, 256]


@pytest.mark.parametrize("kind", [np.uint16, np.int32])
def test_without_one_every_value_becomes_what_it_was(kind: type) -> None:
    """The full range of 16 bits, rounded to the nearest: no finished data set changes."""
    values = np.arange(65_536)
    assert (to_8_bits(values.astype(kind), None) == (values + 128) // 257).all()


def test_dark_bytes_and_floats_are_scaled_too(tmp_path: Path) -> None:
    """The same white for grey and colour; floating-point values, which are refused without it."""
    Image.fromarray(ramp(30).astype(np.uint8)).save(tmp_path / "grey.png")
    assert len(np.unique(decode(tmp_path / "grey.png", 16, 30.0))) == 31
    Image.fromarray((ramp(4095) / 4095).astype(np.float32)).save(tmp_path / "float.tif")
    assert len(np.unique(decode(tmp_path / "float.tif", 16, 1.0))) == 256


@pytest.mark.parametrize("dtype", [np.uint16, np.float32, np.int64])
def test_arrays_of_any_numbers_have_one(tmp_path: Path, dtype: type) -> None:
    """Without it only bytes have a known white, and the message names the setting."""
    images: np.typing.NDArray[Any] = np.stack([ramp(4095)] * 12).astype(dtype)
    source = save_arrays(tmp_path / "a.npz", images=images)
    with refused(DataError, place="images", expected="uint8", got=str(np.dtype(dtype)), remedy="data.white_point"):
        source.catalogue()
    assert len(np.unique(replace(source, white_point=4095.0).catalogue().pictures[0]())) == 256


@pytest.mark.parametrize(
    ("white", "value", "remedy"),
    [(4094.0, 4095, "set a larger data.white_point"), (4095.0, -1, "repair or remove them"), (1.0, np.nan, "")],
)
def test_value_beyond_the_white_is_refused(tmp_path: Path, white: float, value: float, remedy: str) -> None:
    """It would be cut off, which no one would see; a larger white point takes only what is too large."""
    images = np.zeros((12, 8, 8), dtype=np.float32)
    images[3, 0, 0] = value
    source = replace(save_arrays(tmp_path / "a.npz", images=images), white_point=white)
    with refused(DataError, got="(1 found): row 3 (holds values from ", remedy=remedy):
        loaded(source, tmp_path / "cache")


def test_white_that_files_cannot_hold_is_refused(tmp_path: Path) -> None:
    """4095 for bytes would make every image dark; of colour of 16 bits the low bytes are not read."""
    source = replace(save_table(tmp_path, "0.png,1,2,\n1.png,3,4,\n"), white_point=4095.0)
    with refused(DataError, place="data.white_point", got="4095, beyond the bits of files (2 found): line 2"):
        source.catalogue()
    save_deep_colour(tmp_path / "1.png", 4095)
    with refused(DataError, got="(1 found): line 3 '1.png'", remedy="in grey, or with 8 bits"):
        source.catalogue()
    with refused(DataError, place="data.white_point", expected="at most 255", got="256"):
        replace(save_arrays(tmp_path / "a.npz"), white_point=256.0).catalogue()


def test_description_names_the_white_only_where_it_is_set(tmp_path: Path) -> None:
    """Each value is another entry of the cache, with other pixels; none is the entry that there was."""
    source = save_ramps(tmp_path / "ramps", 4095)
    plain, white, whiter = (replace(source, white_point=each) for each in (None, 4095.0, 8190.0))
    assert "white_point" not in str(plain.describe())
    prints = [loaded(each, tmp_path / "cache").facts.fingerprint for each in (plain, white, whiter)]
    assert len(set(prints)) == len(list((tmp_path / "cache").glob("[!.]*"))) == 3
