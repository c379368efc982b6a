"""The images of a data set on a node: found there, made there again, or received from the search.

Promises: a file that a node maps has the very bytes of the search's; it is written once for all runs, whole or not at
all. Labels never come here: those of the training images travel with each job, the others stay with the search.
"""

import contextlib
import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from tacevo.data.dataset import IMAGES
from tacevo.data.loading import make_images
from tacevo.data.source import Source
from tacevo.data.staging import reserve, staged
from tacevo.errors import DataError

#: The variable that names the directory for images on a node.
DIRECTORY = "TACEVO_NODE_DATA"

#: Bytes that are read, and sent, at once.
CHUNK = 32 * 2**20

#: Bytes that a network carries in a second, and what a simulated picture takes: gigabit Ethernet, and seconds on one
#: core, a constant and one for each pixel (`tacevo.data.workers` has the measurement).
_LINK, _PICTURE, _PIXEL = 100e6, 0.9e-3, 5.5e-8


class _OtherBytesError(Exception):
    """The images that were made are not those of the search."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Images:
    """The file that a search maps its images from."""

    #: SHA-256 of the file, 64 hex digits.
    digest: str
    #: Of the file.
    size: int
    #: Number of pictures, and their height and width in pixels.
    pictures: int
    pixels: int
    #: What can make them again: that of simulated ones; None of recorded ones.
    source: Source | None


def describe(path: Path, *, pictures: int, pixels: int, source: Source | None) -> Images:
    """Describe the images of the search."""
    return Images(digest=_digest(path), size=path.stat().st_size, pictures=pictures, pixels=pixels, source=source)


def directory_here() -> Path:
    """Return the directory for images on this node; the default one is made.

    Raises:
        DataError: the default one exists, and is not ours alone: its name can be guessed.
    """
    if named := os.environ.get(DIRECTORY):
        return Path(named)
    default = Path(tempfile.gettempdir()) / f"tacevo-{os.getuid()}"
    default.mkdir(mode=0o700, exist_ok=True)
    found = default.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o022:
        raise DataError(
            f"{'a link' if stat.S_ISLNK(found.st_mode) else stat.filemode(found.st_mode)} of the user {found.st_uid}",
            place=str(default),
            expected=f"a directory of the user {os.getuid()} that others may not write to",
            remedy=f"remove it, or name another in {DIRECTORY}",
        )
    return default


def find(images: Images, directory: Path) -> Path | None:
    """Return the file of these images in a directory; None where it is not there. A damaged one is removed."""
    path = _place(images, directory)
    if not path.exists():
        return None
    if _digest(path) == images.digest:
        return path
    shutil.rmtree(path.parent, ignore_errors=True)
    return None


def is_cheaper_to_make(images: Images, cores: int) -> bool:
    """Tell whether a node with so many cores makes the images in less time than a network brings them."""
    making = images.pictures * (_PICTURE + _PIXEL * images.pixels**2) / cores
    return images.source is not None and making < images.size / _LINK


def make(images: Images, directory: Path, cores: int) -> Path | None:
    """Make the images of a source again; None where other bytes came out, as another CPU may round differently."""
    if images.source is None:
        return None
    catalogue = images.source.catalogue()
    with contextlib.suppress(_OtherBytesError), staged(_place(images, directory).parent) as stage:
        if stage is not None and _digest(make_images(catalogue, stage / IMAGES, cores)) != images.digest:
            raise _OtherBytesError  # so that nothing is kept
    return find(images, directory)


def receive(images: Images, directory: Path, chunks: Iterable[bytes]) -> Path:
    """Write the images that the search sends.

    Raises:
        DataError: there is no room, or the bytes are not those of the search.
    """
    with staged(_place(images, directory).parent) as stage:
        if stage is not None:
            with (stage / IMAGES).open("wb") as file:
                reserve(file, images.size)
                for chunk in chunks:
                    file.write(chunk)
    path = find(images, directory)
    if path is None:
        got, expected = "other bytes", f"the images of the search, of SHA-256 {images.digest[:12]}"
        raise DataError(got, place=str(directory), expected=expected)
    return path


def _place(images: Images, directory: Path) -> Path:
    return directory / images.digest / IMAGES


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
