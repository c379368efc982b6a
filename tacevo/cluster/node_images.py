"""The images of a data set on a node: found there, or received from the search.

Promises: a file that a node maps has the very bytes of the search's; it is written once for all runs, whole or not at
all. Labels never come here: those of the training images travel with each job, the others stay with the search.
"""

import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from tacevo.data.dataset import IMAGES
from tacevo.data.staging import reserve, staged
from tacevo.errors import DataError

#: The variable that names the directory for images on a node.
DIRECTORY = "TACEVO_NODE_DATA"

#: Bytes that are read, and sent, at once.
CHUNK = 32 * 2**20


@dataclass(frozen=True, slots=True, kw_only=True)
class Images:
    """The file that a search maps its images from."""

    #: SHA-256 of the file, 64 hex digits.
    digest: str
    #: The size of the file, in bytes.
    size: int


def describe(path: Path) -> Images:
    """Describe the images of the search."""
    return Images(digest=_digest(path), size=path.stat().st_size)


def directory_here() -> Path:
    """Return the directory for images on this node; the default one is made.

    Raises:
        DataError: the default one exists, and is not ours alone: its name can be guessed.
    """
    if named := os.environ.get(DIRECTORY):
        return Path(named)
    default = Path(tempfile.gettempdir()) / f"tacevo-{os.getuid()}"
    default.mkdir(mode=0o700, exist_ok=True)
    info = default.lstat()
    if not stat.S_ISDIR(info.st_mode) or info.st_uid != os.getuid() or info.st_mode & 0o022:
        raise DataError(
            f"{'a link' if stat.S_ISLNK(info.st_mode) else stat.filemode(info.st_mode)} of the user {info.st_uid}",
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
