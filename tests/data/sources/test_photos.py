"""Image files become upright RGB squares of 8 bits, from every format; what cannot become one is refused by name."""

import hashlib
import resource
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image
from refusals import refused
from small_recordings import save_deep_colour

from tacevo.data.sources.image_files import common_size, decode, files_hash
from tacevo.errors import DataError

#: Values of 16 bits and what they are in 8: round(value * 255 / 65535), worked out by hand.
DEEP = np.array([[0, 128, 129], [385, 386, 40_000], [65_406, 65_407, 65_535]], dtype=np.uint16)
SHALLOW = [[0, 0, 1], [1, 2, 156], [254, 255, 255]]


def claim_size(path: Path, side: int) -> None:
    """Write a PNG file whose header claims so many pixels a side."""
    Image.new("RGBA", (1, 1)).save(path)
    content = bytearray(path.read_bytes())
    content[16:24] = struct.pack(">II", side, side)
    content[29:33] = struct.pack(">I", zlib.crc32(content[12:29]))
    path.write_bytes(content)


def test_image_becomes_square_rgb(tmp_path: Path) -> None:
    """Grey and oblong become three equal channels of the asked size; colours stay in their channels, rows stay rows."""
    Image.new("L", (20, 10), 77).save(tmp_path / "grey.png")
    picture = decode(tmp_path / "grey.png", 6)
    assert picture.dtype == np.uint8
    assert (picture == np.full((3, 6, 6), 77)).all()
    image = Image.new("RGB", (2, 2), (10, 20, 30))
    image.putpixel((1, 0), (99, 20, 30))
    image.save(tmp_path / "colour.png")
    assert decode(tmp_path / "colour.png", 2).tolist() == [[[10, 99], [10, 10]], [[20, 20]] * 2, [[30, 30]] * 2]


@pytest.mark.parametrize("suffix", ["png", "tif", "pgm"])
@pytest.mark.parametrize("order", ["<u2", ">u2"])
def test_grey_of_16_bits_is_scaled_by_its_full_range(tmp_path: Path, suffix: str, order: str) -> None:
    """Black stays 0 and white 255; nothing is cut off, whatever the order of the bytes."""
    path = tmp_path / f"deep.{suffix}"
    if suffix == "pgm":
        path.write_bytes(b"P5 3 3 65535\n" + DEEP.astype(">u2").tobytes())
    else:
        Image.fromarray(DEEP.astype(order)).save(path)
    assert decode(path, 3).tolist() == [SHALLOW] * 3


def test_colour_of_16_bits_keeps_the_high_byte_and_a_palette_is_looked_up(tmp_path: Path) -> None:
    """Pillow keeps value // 256 of each channel: one step off at most. Numbers of colours are not brightness."""
    save_deep_colour(tmp_path / "deep.png", 40_000)
    assert (decode(tmp_path / "deep.png", 4) == 156).all()
    image = Image.new("P", (2, 2), 1)
    image.putpalette([0, 0, 0, 200, 100, 50])
    image.save(tmp_path / "palette.png")
    assert decode(tmp_path / "palette.png", 2)[:, 0, 0].tolist() == [200, 100, 50]


def of(pixels: npt.NDArray[np.generic]) -> Callable[[Path], None]:
    """Return what saves pixels."""
    return lambda path: Image.fromarray(pixels).save(path)


def cut(image: Image.Image, length: int) -> Callable[[Path], object]:
    """Return what saves the first bytes of an image."""

    def save(path: Path) -> None:
        image.save(path)
        path.write_bytes(path.read_bytes()[:length])

    return save


def stacked(path: Path) -> None:
    """Save two images in one file."""
    Image.new("L", (4, 4), 10).save(path, save_all=True, append_images=[Image.new("L", (4, 4), 90)])


def read(path: Path) -> None:
    """Read an image as a search does: all headers first."""
    common_size([("file", path)], None)
    decode(path, 4)


FLOATS = np.full((64, 64), 0.5, dtype=np.float32)
FLOATING = "holds floating-point values, whose full range is unknown"


@pytest.mark.parametrize(
    ("name", "save", "fault"),
    [
        ("float.tif", of(FLOATS), FLOATING),
        ("half.tif", cut(Image.fromarray(FLOATS), 8_000), FLOATING),
        ("large.tif", of(np.full((4, 4), 65_536, dtype=np.int32)), "holds values beyond 16 bits"),
        ("negative.tif", of(np.full((4, 4), -1, dtype=np.int32)), "holds values beyond 16 bits"),
        ("empty.png", lambda path: path.touch(), "is empty"),
        ("absent.png", lambda path: None, "No such file"),
        ("text.png", lambda path: path.write_text("no image"), "is not an image of a known format"),
        ("cut.tif", cut(Image.new("RGB", (8, 8)), 60), "has damaged notes, EXIF or TIFF tags"),
        ("cut.png", cut(Image.effect_noise((64, 64), 50), 1_500), "is damaged or cut off"),
        ("stack.tif", stacked, "holds several images"),
        ("stack.gif", stacked, "holds several images"),
        ("vast.png", lambda path: claim_size(path, 10_000), "has more pixels than any tactile image"),
    ],
)
def test_file_that_cannot_become_an_image_is_refused(
    tmp_path: Path, name: str, save: Callable[[Path], object], fault: str
) -> None:
    """From its header where that says so, else when it is decoded."""
    save(tmp_path / name)
    with refused(DataError, got=fault):
        read(tmp_path / name)


def test_size_is_read_without_the_pixels(tmp_path: Path) -> None:
    """Half a file still has its whole header."""
    cut(Image.effect_noise((64, 64), 50), 1_500)(tmp_path / "half.png")
    assert common_size([("half", tmp_path / "half.png")], None) == ((64, 64), (8,))


def test_remedies_are_those_of_the_faults(tmp_path: Path) -> None:
    """Each file is named with its fault; a setting is named where it helps, and a damaged file is to be repaired."""
    of(FLOATS)(tmp_path / "deep.tif")
    (tmp_path / "torn.png").write_bytes(b"torn")
    got = f"(2 found): one (is not an image of a known format), other ({FLOATING})"
    with refused(DataError, got=got, remedy="repair or remove them, or set data.white_point"):
        common_size([("one", tmp_path / "torn.png"), ("other", tmp_path / "deep.tif")], None)


@pytest.mark.parametrize("mode", ["RGBA", "LA", "P"])
def test_transparent_pixels_are_refused_and_opaque_alpha_is_dropped(tmp_path: Path, mode: str) -> None:
    """What stands behind a transparent pixel is unknown."""
    image = Image.new("RGBA", (2, 2), (50, 50, 50, 255))
    image.convert(mode).save(tmp_path / "opaque.png")
    assert (decode(tmp_path / "opaque.png", 2) == 50).all()
    image.putpixel((1, 1), (50, 50, 50, 0))
    clear = image.convert(mode)
    if mode == "P":
        clear.info["transparency"] = b"\0"  # the palette's one colour
    clear.save(tmp_path / "clear.png")
    with refused(DataError, got="has transparent pixels"):
        decode(tmp_path / "clear.png", 2)


def save_turned(path: Path, orientation: int) -> None:
    """Save a picture of 4 x 2 pixels, white at its top left, with a camera's orientation note."""
    image = Image.new("RGB", (4, 2))
    image.putpixel((0, 0), (255, 255, 255))
    exif = Image.Exif()
    exif[0x0112] = orientation
    image.save(path, exif=exif)


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif"])
@pytest.mark.parametrize(
    ("orientation", "corner", "size"),
    [(1, (0, 0), (4, 2)), (3, (3, 3), (4, 2)), (6, (0, 3), (2, 4)), (8, (3, 0), (2, 4))],
)
def test_orientation_note_of_the_camera_is_obeyed(
    tmp_path: Path, suffix: str, orientation: int, corner: tuple[int, int], size: tuple[int, int]
) -> None:
    """The white pixel goes where a person holding the camera saw it; a quarter turn exchanges width and height."""
    path = tmp_path / f"turned.{suffix}"
    save_turned(path, orientation)
    picture = decode(path, 4)[0]
    assert np.unravel_index(picture.argmax(), picture.shape) == corner
    assert common_size([("turned", path)], None) == (size, (8,))


def test_mixed_sizes_are_refused_beside_the_commonest(tmp_path: Path) -> None:
    """The message gives the size that most have, and names all others, upright."""
    for number, size in enumerate([(4, 4), (4, 2), (4, 2), (4, 2)]):
        Image.new("L", size).save(tmp_path / f"{number}.png")
    save_turned(tmp_path / "4.png", 6)  # equal pixels in the file are not equal pixels on the desk
    files = [(f"picture {number}", tmp_path / f"{number}.png") for number in range(5)]
    got = "3 have 4x2 pixels (width x height), others not (2 found): picture 0 4x4, picture 4 2x4"
    with refused(DataError, got=got):
        common_size(files, None)


def test_image_that_needs_more_memory_than_there_is_is_told(tmp_path: Path) -> None:
    """It is not called damaged."""
    claim_size(tmp_path / "large.png", 9_000)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + 2**24, hard))
    try:
        with refused(DataError, got="needs more memory than there is"):
            decode(tmp_path / "large.png", 4)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def test_hash_follows_bytes_and_order(tmp_path: Path) -> None:
    """Neither two files in another order, nor one byte moved from one to the next, hash alike."""
    for name, content in {"a": b"12", "b": b"3", "c": b"1", "d": b"23"}.items():
        (tmp_path / name).write_bytes(content)
    assert len({files_hash(tmp_path / name for name in names) for names in ("ab", "ba", "cd", "a")}) == 4
    with refused(DataError, place=str(tmp_path), got="a file that cannot be read (Is a directory)"):
        files_hash([tmp_path])


def test_file_is_hashed_in_pieces(tmp_path: Path) -> None:
    """A file of 64 MB never stands in memory as a whole, and hashes as its bytes do."""
    with (tmp_path / "large").open("wb") as file:
        file.truncate(1 << 26)
    tracemalloc.start()
    digest = files_hash([tmp_path / "large"])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1 << 22
    assert digest == hashlib.sha256(hashlib.sha256(bytes(1 << 26)).digest()).hexdigest()
