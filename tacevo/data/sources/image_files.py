"""Image files as every loader reads them: decoded, upright, RGB, square, uint8; and hashed by content."""

import hashlib
import os
import re
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageOps, UnidentifiedImageError

from tacevo.data.source import check_no_faults, check_readable, chosen, shortened
from tacevo.data.sources.filenames import SUFFIXES, is_passed_over
from tacevo.errors import DataError
from tacevo.parts.source import Catalogue, Picture
from tacevo.records import Json

#: Changes when the same file would be decoded to other pixels.
DECODING = "pillow-rgb-bilinear-2"

#: The EXIF tag of the camera's orientation, and its values that exchange width and height.
ORIENTATION, LYING = 0x0112, frozenset({5, 6, 7, 8})

#: Formats in which a file may hold several images, so that the first alone would be an arbitrary choice. Phones' JPEG
#: files hold a preview behind the photograph, which does not count.
STACKS = frozenset({"TIFF", "GIF", "PNG", "WEBP"})

#: The largest value of 16 bits.
_WORD = 65_535.0

#: White may be 1, 255 or anything there.
_FLOATING = "holds floating-point values, whose full range is unknown"


def image_files(directory: Path, pattern: str) -> list[Path]:
    """Find the images of a directory, sorted by path; hidden ones are left out (`is_passed_over`).

    The pattern is `*`, or `**/*` for all directories below too.
    """
    return [path for path in _files(directory, pattern) if path.suffix.lower() in SUFFIXES]


def check_links(directory: Path, pattern: str) -> None:
    """Check that no image of a directory, as `image_files` finds them, is a link to nothing.

    Raises:
        DataError: one is, as in a clone whose files were not fetched.
    """
    images = (path for path in directory.glob(pattern) if path.suffix.lower() in SUFFIXES and path.is_symlink())
    dead = sorted(path.relative_to(directory).as_posix() for path in images if not path.exists())
    shown = [name for name in dead if not is_passed_over(PurePath(name))]
    remedy = "fetch them (`git annex get`, `dvc pull`) or remove them"
    check_no_faults(f"images in {directory} are links to files that are not there", shown, remedy)


def other_files(directory: Path, pattern: str, used: Iterable[Path]) -> list[Path]:
    """Find the files of a directory that are not hidden and not used, sorted by path."""
    known = set(used)
    return [path for path in _files(directory, pattern) if path not in known]


def images_passed_over(directory: Path, pattern: str) -> list[PurePath]:
    """Find the images of a directory that `image_files` leaves out, sorted by path, relative to the directory."""
    images = (path for path in directory.glob(pattern) if path.suffix.lower() in SUFFIXES)
    relative = {path.relative_to(directory): path for path in images}
    return sorted(name for name, path in relative.items() if is_passed_over(name) and path.is_file())


def _linked_out(root: Path, files: Sequence[Path], places: Sequence[str]) -> list[str]:
    """Name the files that lie outside a directory, because they or directories above them are links."""
    own = os.path.realpath(root)
    directories = {directory: os.path.realpath(directory) for directory in {file.parent for file in files}}
    lie_in = (os.path.realpath(file) if file.is_symlink() else directories[file.parent] for file in files)
    return [place for place, lies in zip(places, lie_in, strict=True) if not PurePath(lies).is_relative_to(own)]


def _files(directory: Path, pattern: str) -> list[Path]:
    files = (path for path in directory.glob(pattern) if path.is_file())
    return sorted(path for path in files if not is_passed_over(path.relative_to(directory)))


@dataclass(frozen=True, slots=True, kw_only=True)
class FileSource:
    """The base of the sources of image files: their common settings, and how files become a catalogue."""

    #: The directory that holds them all.
    root: Path
    #: Height and width that images are resized to, in pixels.
    image_size: int
    #: The stored value that becomes 255; None for the full range of the files.
    white_point: float | None = None
    #: A regular expression that finds in an image's path what images of one press share; None: unknown.
    group_pattern: str | None = None

    def described(self, files: Iterable[Path]) -> dict[str, Json]:
        """Name the bytes of image files, and the settings by which they become pictures and groups."""
        settings = chosen(self, "white_point", "group_pattern")
        return {**settings, "decoding": DECODING, "images": files_hash(files), "image_size": self.image_size}

    def catalogue_of(
        self, files: Sequence[Path], places: Sequence[str], paths: Sequence[str], **fields: Any
    ) -> Catalogue:
        """List image files, at least one, which are decoded when their picture is made.

        Places are what messages call them, paths are those that `group_pattern` is about, and `fields` the other fields
        of the catalogue; where groups are among them, the pattern does not count.

        Raises:
            DataError: as `common_size` and `groups_in`.
        """
        if self.group_pattern is not None and "groups" not in fields:
            fields |= {"groups": groups_in(paths, self.group_pattern), "groups_chosen_by": "data.group_pattern"}
        size, depths = common_size(list(zip(places, files, strict=True)), self.white_point)
        return Catalogue(
            image_size=self.image_size,
            pictures=tuple(partial(decode, path, self.image_size, self.white_point) for path in files),
            recorded_size=size,
            files=files,
            places=places,
            depths=depths,
            linked=_linked_out(self.root, files, places),
            extents=tuple(partial(_extent, path, self.white_point) for path in files),
            **fields,
        )


def decode(path: Path, image_size: int, white_point: float | None = None) -> Picture:
    """Decode one image file to a square RGB picture.

    The camera's orientation note (EXIF) is obeyed; then 8 bits are kept of every channel (`to_8_bits`), and the image
    is resized by `square`.

    Returns:
        uint8, shape (3, image_size, image_size).

    Raises:
        DataError: the file cannot be read, has transparent pixels, or values of an unknown range; the
            message names the fault alone, because the caller knows what the user calls this image.
    """
    return square(to_8_bits(_stored(path), white_point), image_size)


def _extent(path: Path, white_point: float | None) -> tuple[float, float]:
    return extent(_stored(path), white_point)


@contextmanager
def warnings_as_errors() -> Iterator[None]:
    """Make an error of what Pillow warns of, damage after which it goes on, in all threads of this process."""
    with warnings.catch_warnings():
        for kind in (UserWarning, Image.DecompressionBombWarning):
            warnings.simplefilter("error", kind)
        yield


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """Open an image; an error of Pillow becomes a `DataError` that names the fault.

    Only Pillow's own work belongs inside: a bug of ours would be reported as damage of the file.
    """
    try:
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


def square(values: npt.NDArray[np.uint8], image_size: int) -> Picture:
    """Resize grey values, shape (H, W), or colours, (H, W, 3), with Pillow's bilinear filter; grey is repeated.

    The filter averages over all source pixels when it makes an image smaller. A change of aspect is accepted.

    Returns:
        uint8, shape (3, image_size, image_size).
    """
    image = Image.fromarray(values).convert("RGB")
    resized = image.resize((image_size, image_size), Image.Resampling.BILINEAR)
    return np.ascontiguousarray(np.asarray(resized, dtype=np.uint8).transpose(2, 0, 1))


def _stored(path: Path) -> npt.NDArray[Any]:
    """Read the values of an upright image: grey beyond 8 bits as it is, shape (H, W), all else as RGB, (H, W, 3).

    A palette is looked up. Of RGB with 16 bits per channel Pillow itself keeps the high byte, which is at most one step
    darker.
    """
    with _opened(path) as file:
        # Asked for first, by the size in the header: where memory lacks, Pillow may call a whole image cut off.
        np.empty((file.height, file.width, 4), np.uint8)
        image = ImageOps.exif_transpose(file)
    if image.mode.startswith(("I", "F")):
        return np.asarray(image)
    if image.has_transparency_data:
        image = image.convert("RGBA")
        if image.getchannel("A").getextrema()[0] != 255:
            raise DataError("has transparent pixels")
    return np.asarray(image.convert("RGB"))


def to_8_bits(values: npt.NDArray[Any], white_point: float | None) -> npt.NDArray[np.uint8]:
    """Scale values so that the white point becomes 255: round(value * 255 / white), shape unchanged.

    Without a white point, bytes stay as they are and other whole numbers are scaled by the full range of 16 bits.

    Raises:
        DataError: the range is unknown, or a value is outside it.
    """
    if white_point is None and values.dtype == np.uint8:
        return values
    if white_point is None and values.dtype.kind == "f":
        raise DataError(_FLOATING, remedy="set data.white_point")
    white = _WORD if white_point is None else white_point
    low, high = float(values.min()), float(values.max())
    if not (low >= 0 and high <= white):  # which NaN is not, either
        if white_point is None:
            raise DataError("holds values beyond 16 bits")
        beyond = f"holds values from {low:g} to {high:g}, beyond data.white_point={white:g}"
        raise DataError(beyond, remedy="set a larger data.white_point" if high > white else "")
    return np.floor(values.astype(np.float64) * 255 / white + 0.5).astype(np.uint8)


def extent(values: npt.NDArray[Any], white_point: float | None) -> tuple[float, float]:
    """Return the largest stored value of an image, and the value that becomes 255."""
    full = 255.0 if values.dtype == np.uint8 else _WORD
    return float(values.max()), full if white_point is None else white_point


def common_size(
    files: Sequence[tuple[str, Path]], white_point: float | None
) -> tuple[tuple[int, int], tuple[int, ...]]:
    """Find the one size that all images have once they are upright, and the depth of each; only headers are read.

    A data set of mixed sizes is refused, because resizing would stretch each size by another factor. An orientation
    note behind the pixels of a PNG file is not looked for. Each file, of at least one, comes with what the user knows
    it by, e.g. `line 3 'a.png'`.

    Returns:
        Width and height in pixels; the bits that each file has for a value.

    Raises:
        DataError: files cannot be read, hold several or floating-point values, differ in size, or hold no value as
            large as the white point.
    """
    headers = []
    unreadable = []
    with warnings_as_errors():
        for name, path in files:
            try:
                headers.append((name, *_header(path, white_point)))
            except DataError as error:
                unreadable.append((name, error))
    check_readable(unreadable)
    (width, height), images = Counter(size for _, size, _ in headers).most_common(1)[0]
    check_no_faults(
        f"images have several sizes; {images} have {width}x{height} pixels (width x height), others not",
        [f"{name} {size[0]}x{size[1]}" for name, size, _ in headers if size != (width, height)],
        "crop or remove the others",
    )
    if white_point is not None:
        check_no_faults(
            f"{white_point:g}, beyond the bits of files",
            [f"{name} has {depth}" for name, _, depth in headers if white_point > 2**depth - 1],
            "lower it",
            place="data.white_point",
            expected="a value that all files can hold",
        )
    return (width, height), tuple(depth for *_, depth in headers)


def _header(path: Path, white_point: float | None) -> tuple[tuple[int, int], int]:
    """Read width and height, as they are after the orientation note is obeyed, and the bits of a value in the file."""
    with _opened(path) as file:
        stacked = file.format in STACKS and getattr(file, "n_frames", 1) > 1
        (width, height), mode = file.size, file.mode
        coded = str(getattr(file, "tile", ""))  # 'I;16B', 'RGB;16L': how the pixels are stored
        # The base class's method: that of PNG files decodes all pixels to look behind them. Pillow gives the size of
        # TIFF files upright.
        lying = file.format != "TIFF" and Image.Image.getexif(file).get(ORIENTATION) in LYING
    if stacked:
        raise DataError("holds several images")
    if mode.startswith("F") and white_point is None:
        raise DataError(_FLOATING, remedy="set data.white_point")
    wide = mode.startswith(("I", "F"))
    depth = 16 if ";16" in mode + coded else 32 if wide else 8
    if depth > 8 and not wide and white_point is not None:
        got = "has 16 bits a channel, of which the high byte alone is read, so data.white_point has no meaning"
        raise DataError(got, remedy="save colour in grey, or with 8 bits a channel")
    return (height, width) if lying else (width, height), depth


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


def numbered(shared: Sequence[str]) -> npt.NDArray[np.int64]:
    """Number what the images of a press share: int64, equal where the texts are."""
    return np.unique(np.array(shared, dtype=object), return_inverse=True)[1].astype(np.int64)


def groups_in(paths: Sequence[str], pattern: str) -> npt.NDArray[np.int64]:
    """Find the groups of images by a regular expression on their paths.

    The parts in brackets that it finds are what the images of a group share; without brackets, all that it finds.

    Returns:
        int64, shape (N,): equal for images of one group.

    Raises:
        DataError: a path does not hold the expression.
    """
    matches = [re.search(pattern, path) for path in paths]
    check_no_faults(
        f"paths do not hold the regular expression {pattern!r}",
        [shortened(path) for path, match in zip(paths, matches, strict=True) if match is None],
        "write one that finds in each path what the images of one press share",
        place="data.group_pattern",
    )
    shared = [repr(match.groups() or match[0]) for match in matches if match is not None]
    return numbered(shared)
