"""Image files as every loader reads them: decoded, upright, RGB, square, uint8; and hashed by content."""

import hashlib
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageOps, UnidentifiedImageError

from tacevo.data.source import Catalogue, Picture, check_no_faults
from tacevo.errors import DataError

#: Changes when the same file would be decoded to other pixels.
DECODING = "pillow-rgb-bilinear-2"

#: Endings of the image files that are looked for in directories, in lower case.
SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff"})

#: The EXIF tag of the camera's orientation, and its values that exchange width and height.
ORIENTATION, LYING = 0x0112, frozenset({5, 6, 7, 8})

#: Formats in which a file may hold several images, so that the first alone would be an arbitrary choice. Phones' JPEG
#: files hold a preview behind the photograph, which does not count.
STACKS = frozenset({"TIFF", "GIF", "PNG", "WEBP"})

#: What is wrong with pixels of modes F and F;..., whose white may be 1, 255 or anything.
_FLOATING = "holds floating-point values, whose full range is unknown"


def image_files(directory: Path, pattern: str) -> list[Path]:
    """Find the images of a directory, sorted by path.

    Hidden files and directories are left out: editors and systems put copies and stubs there, such as
    `.ipynb_checkpoints/1-checkpoint.png` and `._1.png`.

    The pattern is `*`, or `**/*` for all directories below too.
    """
    images = (path for path in directory.glob(pattern) if path.suffix.lower() in SUFFIXES and path.is_file())
    return sorted(path for path in images if not _hidden(path.relative_to(directory)))


def other_files(directory: Path, pattern: str, used: Iterable[Path]) -> list[Path]:
    """Find the files of a directory that are not hidden and not used, sorted by path: `image_files`' remainder."""
    known = set(used)
    files = (path for path in directory.glob(pattern) if path not in known and path.is_file())
    return sorted(path for path in files if not _hidden(path.relative_to(directory)))


def _hidden(path: Path) -> bool:
    return any(part.startswith(".") for part in path.parts)


def file_catalogue(files: Sequence[Path], places: Sequence[str], image_size: int, **fields: Any) -> Catalogue:
    """List image files, at least one, which are decoded when their picture is made.

    Places are what messages call them, and `fields` the other fields of the catalogue.

    Raises:
        DataError: as `common_size`.
    """
    return Catalogue(
        image_size=image_size,
        pictures=tuple(partial(decode, path, image_size) for path in files),
        recorded_size=common_size(list(zip(places, files, strict=True))),
        files=files,
        places=places,
        **fields,
    )


def decode(path: Path, image_size: int) -> Picture:
    """Decode one image file to a square RGB picture.

    The camera's orientation note (EXIF) is obeyed; then 8 bits are kept of every channel (`_to_rgb`), and the image
    is resized by `square`.

    Returns:
        uint8, shape (3, image_size, image_size).

    Raises:
        DataError: the file cannot be read, has transparent pixels, or values of an unknown range; the
            message names the fault alone, because the caller knows what the user calls this image.
    """
    with _opened(path) as file:
        upright = ImageOps.exif_transpose(file)
    return square(_to_rgb(upright), image_size)


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """Open an image; an error of Pillow becomes a `DataError` that names the fault.

    Only Pillow's own work belongs inside: a bug of ours would be reported as damage of the file.
    """
    try:
        with warnings.catch_warnings():
            for kind in (UserWarning, Image.DecompressionBombWarning):  # Pillow warns of damage and goes on
                warnings.simplefilter("error", kind)
            with Image.open(path) as file:
                yield file
    except Exception as error:  # of Pillow and its decoders, which raise more than a dozen classes
        raise DataError(_fault(path, error)) from error


def _fault(path: Path, error: Exception) -> str:
    """Return what is wrong with a file that Pillow cannot read."""
    match error:
        case Image.DecompressionBombError() | Image.DecompressionBombWarning():
            return "has more pixels than any tactile image"
        case UnidentifiedImageError():
            return "is empty" if path.stat().st_size == 0 else "is not an image of a known format"
        case OSError(strerror=str() as reason):
            return reason
        case MemoryError():
            return "needs more memory than there is"
        case UserWarning():
            return "has damaged notes, EXIF or TIFF tags"
    return "is damaged or cut off"


def square(image: Image.Image, image_size: int) -> Picture:
    """Resize an RGB image with Pillow's bilinear filter.

    The filter averages over all source pixels when it makes an image smaller. A change of aspect is accepted.

    Returns:
        uint8, shape (3, image_size, image_size).
    """
    resized = image.resize((image_size, image_size), Image.Resampling.BILINEAR)
    return np.ascontiguousarray(np.asarray(resized, dtype=np.uint8).transpose(2, 0, 1))


def _to_rgb(image: Image.Image) -> Image.Image:
    """Convert any image to RGB of 8 bits: grey is repeated, a palette looked up, 16-bit grey divided by 257.

    Of RGB with 16 bits per channel Pillow itself keeps the high byte, which is at most one step darker.
    """
    if image.mode.startswith(("I", "F")):
        return Image.fromarray(_to_8_bits(np.asarray(image))).convert("RGB")
    if image.has_transparency_data:
        image = image.convert("RGBA")
        if image.getchannel("A").getextrema()[0] != 255:
            raise DataError("has transparent pixels")
    return image.convert("RGB")


def _to_8_bits(grey: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """Scale whole numbers of 16 bits by their full range: round(value * 255 / 65535), shape unchanged."""
    if grey.dtype.kind == "f":
        raise DataError(_FLOATING)
    if grey.min() < 0 or grey.max() > 65_535:
        raise DataError("holds values beyond 16 bits")
    return ((grey.astype(np.uint32) + 128) // 257).astype(np.uint8)


def common_size(files: Sequence[tuple[str, Path]]) -> tuple[int, int]:
    """Find the one size that all images have once they are upright; only their headers are read.

    A data set of mixed sizes is refused, because resizing would stretch each size by another factor. An orientation
    note behind the pixels of a PNG file is not looked for. Each file, of at least one, comes with what the user knows
    it by, e.g. `line 3 'a.png'`; the size is width and height in pixels.

    Raises:
        DataError: files cannot be read, hold several or floating-point values, or differ in size.
    """
    sizes: list[tuple[str, tuple[int, int]]] = []
    unreadable = []
    for name, path in files:
        try:
            sizes.append((name, _upright_size(path)))
        except DataError as error:
            unreadable.append(f"{name} ({error})")
    check_no_faults("some images cannot be read", unreadable, "repair or remove them")
    (width, height), images = Counter(size for _, size in sizes).most_common(1)[0]
    others = [f"{name} {size[0]}x{size[1]}" for name, size in sizes if size != (width, height)]
    check_no_faults(
        f"images have several sizes; {images} have {width}x{height} pixels (width x height), others not",
        others,
        "crop or remove the others",
    )
    return width, height


def _upright_size(path: Path) -> tuple[int, int]:
    """Read width and height from a header, as they are after the orientation note is obeyed.

    Raises:
        DataError: the header shows that the image cannot be used.
    """
    with _opened(path) as file:
        stacked = file.format in STACKS and getattr(file, "n_frames", 1) > 1
        (width, height), mode = file.size, file.mode
        # The base class's method: that of PNG files decodes all pixels to look behind them. Pillow gives the size of
        # TIFF files upright.
        lying = file.format != "TIFF" and Image.Image.getexif(file).get(ORIENTATION) in LYING
    if stacked:
        raise DataError("holds several images")
    if mode.startswith("F"):
        raise DataError(_FLOATING)
    return (height, width) if lying else (width, height)


def files_hash(paths: Iterable[Path]) -> str:
    """Hash the bytes of files, in order: SHA-256 over the SHA-256 of each, so an edited image is noticed.

    A file is read in pieces, so one larger than the memory can be hashed.

    Raises:
        DataError: a file cannot be read.
    """
    digest = hashlib.sha256()
    for path in paths:
        try:
            with path.open("rb") as file:
                digest.update(hashlib.file_digest(file, "sha256").digest())
        except OSError as error:
            raise DataError(f"a file that cannot be read ({error.strerror})", place=str(path)) from error
    return digest.hexdigest()
