"""A finished data set: uint8 images on disk, scaled targets, the split, and a fingerprint over all of it.

Promises: `read` returns unchanged what `write` left on disk; every value that training can see enters the
fingerprint. It does not check the images again on reading: that is what comparing `fingerprint` is for.
"""

import contextlib
import hashlib
import io
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tacevo.data.scaling import BLOCK
from tacevo.errors import DataError, StoreError
from tacevo.records import DataFacts, Record, to_json
from tacevo.storage.canonical import canonical
from tacevo.storage.files import write_durably
from tacevo.typed import parse

#: Changes when the header or the order of the bytes that enter the fingerprint changes.
FINGERPRINT_SCHEMA = 1

IMAGES = "images.npy"

FACTS = "facts.json"

#: The fields of `Dataset` that are kept as one `.npy` file each, in the order in which they are hashed.
ARRAYS = ("targets", "train", "validation", "test")

#: The groups of the test images, int64 (t,), empty where none are known. Entries of earlier releases lack the file, and
#: these find no other key in `facts.json`.
GROUPS = "groups.npy"

#: The fields of `Dataset` that stand in `facts.json` beside the facts.
STATISTICS = ("mean", "deviation", "offset", "scale")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Facts(Record):
    """The content of `facts.json`; the fields are those of `Dataset`."""

    facts: DataFacts
    mean: tuple[float, ...]
    deviation: tuple[float, ...]
    offset: tuple[float, ...]
    scale: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dataset:
    """Everything that training needs of a data set; N images, C channels, S pixels a side, K outputs."""

    facts: DataFacts
    #: An `.npy` file, uint8, shape (N, C, S, S), values 0 to 255: `np.load(images, mmap_mode="r")`.
    images: Path
    #: Regression: float32 (N, K), equal to (label - offset) / scale. Classification: int64 (N,), in [0, K).
    targets: npt.NDArray[np.float32] | npt.NDArray[np.int64]
    #: Row numbers of the three parts, int64, ascending.
    train: npt.NDArray[np.int64]
    validation: npt.NDArray[np.int64]
    test: npt.NDArray[np.int64]
    #: The mean of each channel, in units of the pixel values 0 to 255: input = (pixel - mean) / deviation.
    mean: tuple[float, ...]
    deviation: tuple[float, ...]
    #: The offset of each output, in the units of the recording; empty for classification.
    offset: tuple[float, ...]
    scale: tuple[float, ...]


def fingerprint(dataset: Dataset) -> str:
    """Hash every value that training can see: SHA-256 in 64 hex digits.

    The hash runs over a canonical JSON header (names, shapes, statistics) and the raw little-endian bytes of
    images, targets and split; it does not depend on `dataset.facts.fingerprint` or on where the images lie.
    """
    images = np.load(dataset.images, mmap_mode="r")
    arrays = {name: getattr(dataset, name) for name in ARRAYS}
    header = {
        "schema": FINGERPRINT_SCHEMA,
        "names": to_json(dataset.facts.names),
        "shapes": {name: [str(array.dtype), *array.shape] for name, array in {"images": images, **arrays}.items()},
        **{name: to_json(getattr(dataset, name)) for name in STATISTICS},
    }
    digest = hashlib.sha256(canonical(header).encode())
    for start in range(0, len(images), BLOCK):
        digest.update(images[start : start + BLOCK].tobytes())
    for array in arrays.values():
        digest.update(array.astype(array.dtype.newbyteorder("<")).tobytes())
    return digest.hexdigest()


def with_fingerprint(dataset: Dataset) -> Dataset:
    """Return the data set with its fingerprint in its facts."""
    return replace(dataset, facts=replace(dataset.facts, fingerprint=fingerprint(dataset)))


def write(dataset: Dataset, directory: Path) -> None:
    """Write everything but the images into a directory, where the images are already."""
    for name in ARRAYS:
        np.save(directory / f"{name}.npy", getattr(dataset, name))
    np.save(directory / GROUPS, np.array(dataset.facts.groups, dtype=np.int64))
    facts = {
        "facts": to_json(replace(dataset.facts, groups=())),
        **{name: to_json(getattr(dataset, name)) for name in STATISTICS},
    }
    (directory / FACTS).write_text(json.dumps(facts, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def with_groups(dataset: Dataset, groups: tuple[int, ...]) -> Dataset:
    """Return a data set that was read with the groups that it lacks, and write them beside it if that can be done."""
    file = io.BytesIO()
    np.save(file, np.array(groups, dtype=np.int64))
    with contextlib.suppress(StoreError):  # a cache that others share may not be ours to write to
        write_durably(dataset.images.parent / GROUPS, file.getvalue())
    return replace(dataset, facts=replace(dataset.facts, groups=groups))


def read(directory: Path) -> Dataset:
    """Read what `write` left in a directory, without reading the images; without groups where their file is missing.

    Raises:
        DataError: a file is missing or damaged.
    """
    remedy = f"delete {directory} and start again"
    try:
        text = (directory / FACTS).read_bytes()
        images = (directory / IMAGES).resolve(strict=True)
        arrays = {name: np.load(directory / f"{name}.npy") for name in ARRAYS}
        groups = np.load(directory / GROUPS) if (directory / GROUPS).exists() else np.empty(0, np.int64)
    except (OSError, ValueError) as error:
        raise DataError(f"the cached data set is damaged ({error})", place=str(directory), remedy=remedy) from error
    kept = parse(_Facts, text, place=str(directory / FACTS), error=DataError, remedy=remedy)
    statistics = {name: getattr(kept, name) for name in STATISTICS}
    try:
        if groups.dtype != np.int64 or groups.ndim != 1:
            raise ValueError("a row of integers")
        facts = replace(kept.facts, groups=tuple(groups.tolist()))
    except ValueError as error:
        raise DataError("other values", place=str(directory / GROUPS), expected=str(error), remedy=remedy) from error
    return Dataset(facts=facts, images=images, **arrays, **statistics)
