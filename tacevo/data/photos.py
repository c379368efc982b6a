"""Image files as every loader reads them: decoded, upright, RGB, square, uint8; and hashed by content."""

import hashlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from tacevo.data.source import Picture
from tacevo.errors import DataError

#: Changes when the same file would be decoded to other pixels.
DECODING = "pillow-rgb-bilinear-1"


def decode(path: Path, image_size: int) -> Picture:
    """Decode one image file to a square RGB picture.

    The camera's orientation note (EXIF) is obeyed; then the image is resized with Pillow's bilinear filter, which
    averages over all source pixels when it makes an image smaller. A change of aspect is accepted.

    Args:
        path: a file that Pillow can read.
        image_size: height and width of the result, in pixels.

    Returns:
        uint8, shape (3, image_size, image_size).

    Raises:
        DataError: the file is not a readable image of 8 bits per channel.
    """
    try:
        with Image.open(path) as file:
            deep = file.mode.startswith(("I", "F"))
            upright = ImageOps.exif_transpose(file).convert("RGB")
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise DataError(f"{path.parent.name}/{path.name} ({type(error).__name__})") from error
    if deep:  # Pillow would cut such values off at 255
        raise DataError(f"{path.parent.name}/{path.name} (more than 8 bits per channel)")
    square = upright.resize((image_size, image_size), Image.Resampling.BILINEAR)
    return np.ascontiguousarray(np.asarray(square, dtype=np.uint8).transpose(2, 0, 1))


def files_hash(paths: Iterable[Path]) -> str:
    """Hash the bytes of files, in order: SHA-256 over the SHA-256 of each, so an edited image is noticed."""
    digest = hashlib.sha256()
    for path in paths:
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()
