"""A NumPy archive (`.npz`) as a source: images and labels as arrays, made by a lab's own script.

    images   uint8, (N, H, W), (N, H, W, 1) or (N, H, W, 3) in the order red, green, blue; with data.white_point any
             numbers
    labels   floats (N,) or (N, K): regression; integers (N,) from 0 to K - 1: classification
    names    text (K,), may be absent: names of the outputs or classes
    groups   integers (N,), may be absent: equal for rows that were recorded together

Further arrays of texts or integers (N,) may name the sensor and the part of each image; settings name these arrays.

The archive is read whole into memory, and nothing in it is ever unpickled.
"""

import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import numpy.typing as npt

from tacevo.data.sensors import NONE_NAMED, Named, Sensors, taken
from tacevo.data.source import check_no_faults, chosen
from tacevo.data.sources.filenames import check_file, is_passed_over
from tacevo.data.sources.image_files import DECODING, extent, files_hash, square, to_8_bits
from tacevo.errors import DataError
from tacevo.parts.making import Given
from tacevo.parts.source import Catalogue, Picture
from tacevo.records import Json, Kind
from tacevo.text import first_line

_ARCHIVE = "a NumPy archive (.npz)"

_REMEDY = "save images and labels together with numpy.savez, as numbers and texts"

REQUIRED, OPTIONAL = frozenset({"images", "labels"}), frozenset({"names", "groups"})


def from_settings(given: Given) -> "Arrays":
    """Make the source of a NumPy archive from the settings of `data`."""
    data = given.settings
    return Arrays(
        root=Path(data["root"] or ""),
        image_size=data["image_size"],
        white_point=data["white_point"],
        sensors=Sensors.from_settings(given),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Arrays:
    """A data set in one archive; the kind of its labels follows from their type."""

    #: The archive.
    root: Path
    #: Height and width that images are resized to, in pixels.
    image_size: int
    #: The stored value that becomes 255; None for images of 8 bits as they are.
    white_point: float | None = None
    #: The sensors and parts that are taken, where arrays name them.
    sensors: Sensors = NONE_NAMED

    def describe(self) -> Json:
        """Name the bytes of the archive."""
        check_file(self.root, "data.root", _ARCHIVE)
        content = files_hash([self.root])
        described: dict[str, Json] = {"source": "numpy", "decoding": DECODING, "archive": content}
        described |= self.sensors.described()
        return {**described, "image_size": self.image_size, **chosen(self, "white_point")}

    def catalogue(self) -> Catalogue:
        """List labels and images in the order of the arrays."""
        arrays = _read(self.root, self.sensors.columns)
        images, labels, names = arrays["images"], arrays["labels"], arrays.get("names")
        _check_images(images, self.white_point)
        count = len(images)
        if labels.shape[:1] != (count,):
            expected = f"one row for each of the {count} images"
            raise DataError(f"shape {labels.shape}", place="labels", expected=expected)
        is_classified = labels.dtype.kind in "iu"
        groups = _groups(arrays.get("groups"), count)
        outputs = _count_classes(labels, names) if is_classified else _count_values(labels)
        values = labels.astype(np.int64) if is_classified else labels.astype(np.float64).reshape(count, outputs)
        rows: list[int] = list(range(count))
        fields: dict[str, Any] = {"groups": groups}
        if self.sensors.are_named:
            sensor, split = (
                None if name is None else _texts(arrays[name], name, count)
                for name in (self.sensors.sensor_column, self.sensors.split_column)
            )
            places = [f"row {row}" for row in rows]
            classes = labels.astype(np.int64) if is_classified else None
            named = Named(places, sensor, split, classes=classes, groups=groups)
            rows, fields = taken(self.sensors, named)
        return Catalogue(
            kind=Kind.classification if is_classified else Kind.regression,
            names=_names(names, outputs, "{}" if is_classified else "label {}"),
            labels=values[rows],
            image_size=self.image_size,
            pictures=tuple(partial(_resized, images[row], self.image_size, self.white_point) for row in rows),
            extents=tuple(partial(extent, images[row], self.white_point) for row in rows),
            recorded_size=(images.shape[2], images.shape[1]),
            **fields,
        )


def _resized(image: npt.NDArray[Any], image_size: int, white_point: float | None) -> Picture:
    """Scale and resize one image as files are; raises as `to_8_bits`."""
    flat = image[:, :, 0] if image.shape[2:] == (1,) else image
    return square(to_8_bits(flat, white_point), image_size)


def _read(path: Path, naming: Sequence[str] = ()) -> dict[str, npt.NDArray[Any]]:
    """Read all arrays of an archive, those among them that name sensors or parts."""
    check_file(path, "data.root", _ARCHIVE)
    if not zipfile.is_zipfile(path):
        got = "a file of another kind, or one that was cut off"
        raise DataError(got, place=str(path), expected=_ARCHIVE, remedy=_REMEDY)
    with path.open("rb") as file:  # NumPy would leave it open where it raises
        with _refused_where_damaged(path):
            archive = np.load(file, allow_pickle=False)
        with archive:
            names = [name for name in archive.files if not is_passed_over(PurePath(name))]
            _check_keys(path, frozenset(names), frozenset(naming))
            return {name: _array(path, archive, name) for name in names}


@contextmanager
def _refused_where_damaged(place: object) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # zipfile, zlib and NumPy raise a dozen classes for a damaged file
        raise DataError(f"what cannot be read ({first_line(error)})", place=str(place), remedy=_REMEDY) from error


def _array(path: Path, archive: Mapping[str, Any], name: str) -> npt.NDArray[Any]:
    """Read one array; an array of Python objects would have to be unpickled, which runs its author's code."""
    with _refused_where_damaged(f"{path}, {name}"):
        array = archive[name]
    if not isinstance(array, np.ndarray):
        raise DataError(type(array).__name__, place=f"{path}, {name}", expected="an array", remedy=_REMEDY)
    return array


def _check_keys(path: Path, names: frozenset[str], naming: frozenset[str]) -> None:
    """Refuse an archive that lacks an array, or has an unknown one: a misspelt `groups` would leak."""
    check_no_faults(f"{path.name} lacks arrays", sorted((REQUIRED | naming) - names), f"it has {sorted(names)}")
    unknown = sorted(names - REQUIRED - OPTIONAL - naming)
    remedy = (
        f"remove them, or name them by data.sensor_column or data.split_column; known are {sorted(REQUIRED | OPTIONAL)}"
    )
    check_no_faults(f"{path.name} has unknown arrays", unknown, remedy)


def _check_images(images: npt.NDArray[Any], white_point: float | None) -> None:
    is_shaped = images.size > 0 and (images.ndim == 3 or (images.ndim == 4 and images.shape[3] in (1, 3)))
    is_known = images.dtype == np.uint8 or (white_point is not None and images.dtype.kind in "uif")
    if not (is_known and is_shaped):
        number = "uint8" if white_point is None else "numbers"
        raise DataError(
            f"{images.dtype} of shape {images.shape}",
            place="images",
            expected=f"{number} of shape (N, H, W), (N, H, W, 1) or (N, H, W, 3)",
            remedy="other numbers need data.white_point, the value that is white",
        )
    if white_point is not None and images.dtype == np.uint8 and white_point > 255:
        expected = "at most 255 for images of 8 bits"
        raise DataError(f"{white_point:g}", place="data.white_point", expected=expected)


def _count_classes(labels: npt.NDArray[Any], names: npt.NDArray[Any] | None) -> int:
    """Count the classes; each must have images."""
    if labels.ndim != 1:
        raise DataError(
            f"integers of shape {labels.shape}",
            place="labels",
            expected="classes as integers of shape (N,)",
            remedy="save values as floats",
        )
    present = np.unique(labels)
    outputs = len(present) if names is None else names.size
    faults = [f"row {row} is {labels[row]}" for row in np.flatnonzero((labels < 0) | (labels >= outputs))]
    what = "classes" if names is None else "names"
    check_no_faults(
        "class numbers do not run from 0 without a gap", faults, f"there are {outputs} {what}; number them from 0"
    )
    empty = [str(number) for number in sorted(set(range(outputs)) - set(present.tolist()))]
    check_no_faults("some classes have no images", empty, "add images or remove their names")
    return outputs


def _count_values(labels: npt.NDArray[Any]) -> int:
    """Count the regressed values; all must be finite."""
    if labels.dtype.kind != "f" or labels.dtype.itemsize > 8 or labels.ndim > 2 or labels.size == 0:
        expected = "floats of at most 64 bits, of shape (N,) or (N, K), or integers of shape (N,)"
        raise DataError(f"{labels.dtype} of shape {labels.shape}", place="labels", expected=expected)
    columns = labels.reshape(len(labels), -1)
    rows = np.flatnonzero(~np.isfinite(columns).all(axis=1))
    faults = [f"row {row} is {columns[row].tolist()}" for row in rows]
    check_no_faults("labels are not finite numbers", faults, "correct or remove these rows, counted from 0")
    return columns.shape[1]


def _names(names: npt.NDArray[Any] | None, outputs: int, default: str) -> tuple[str, ...]:
    if names is None:
        return tuple(default.format(number) for number in range(outputs))
    if names.dtype.kind != "U" or names.shape != (outputs,) or len(set(names.tolist())) != outputs:
        got = f"{names.dtype} of shape {names.shape}: {names.tolist()}"
        raise DataError(got, place="names", expected=f"{outputs} different texts")
    return tuple(names.tolist())


def _texts(values: npt.NDArray[Any], name: str, count: int) -> list[str]:
    """Read what names the sensor or the part of each image."""
    if values.shape != (count,) or values.dtype.kind not in "Uiu":
        expected = f"{count} texts or integers"
        raise DataError(f"{values.dtype} of shape {values.shape}", place=name, expected=expected)
    texts = [str(value).strip() for value in values.tolist()]
    empty = [f"row {row}" for row, text in enumerate(texts) if not text]
    check_no_faults(f"{name} has rows without a value", empty, "write there what names the sensor or the part")
    return texts


def _groups(groups: npt.NDArray[Any] | None, count: int) -> npt.NDArray[np.int64] | None:
    if groups is None:
        return None
    if groups.shape != (count,) or groups.dtype.kind not in "iu":
        raise DataError(f"{groups.dtype} of shape {groups.shape}", place="groups", expected=f"{count} integers")
    return groups.astype(np.int64)
