"""The probable faults in the light of images that can be used."""

import math
from collections import Counter

import numpy as np
import numpy.typing as npt

from tacevo.data.dataset import Dataset
from tacevo.data.source import SHOWN_FAULTS, listed
from tacevo.parts.source import Catalogue

#: Images are dark where none uses more than one part in so many of its range.
DARK = 8


def doubtful_images(catalogue: Catalogue, dataset: Dataset) -> list[str]:
    """Say what is probably wrong, a sentence each: files of several depths, images that use little of their range.

    Raises:
        DataError: an image that was made before cannot be read any more.
    """
    return [words for words in (_several_depths(catalogue), _dark(catalogue, dataset)) if words]


def _several_depths(catalogue: Catalogue) -> str:
    counts = Counter(catalogue.depths).most_common()
    if len(counts) < 2:
        return ""
    shown = ", ".join(f"{images} of {bits} bits" for bits, images in counts)
    rare = [place for place, bits in zip(catalogue.places or (), catalogue.depths, strict=True) if bits != counts[0][0]]
    return (
        f"images have different depths ({shown}; not of {counts[0][0]}: {listed(rare, most=SHOWN_FAULTS)}), and each "
        "is scaled by its own: save all in one, or set data.white_point where equal values mean equal light"
    )


def _dark(catalogue: Catalogue, dataset: Dataset) -> str:
    """Say how little images use of their range; the files are read again only where the finished images are dark."""
    images: npt.NDArray[np.uint8] = np.load(dataset.images, mmap_mode="r")
    if not catalogue.extents or any(int(image.max()) > 255 // DARK + 1 for image in images):
        return ""
    extents = [extent() for extent in catalogue.extents]
    if any(largest * DARK > white for largest, white in extents):
        return ""
    largest, white = max(extents)
    told = f"no image uses more than an eighth of its range: the largest stored value is {largest:g} of {white:g}"
    if largest == 0:
        return f"{told}, so that all images are black"
    if any(bits > 8 and full == 255 for bits, (_, full) in zip(catalogue.depths, extents, strict=False)):
        return f"{told}, the high byte of 16 bits: save the images in grey, or with 8 bits a channel"
    levels = math.floor(largest * 255 / white + 0.5) + 1
    return f"{told}, so that {levels} of 256 grey levels are left: set data.white_point={_white(largest)}"


def _white(largest: float) -> int:
    """Return the white of the fewest bits that hold a value; 1 for what is between 0 and 1."""
    return int(2 ** max(1, math.ceil(math.log2(largest + 1))) - 1)
