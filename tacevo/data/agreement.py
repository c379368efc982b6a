"""Whether what a source lists and makes is what `tacevo.parts.source` says; the source may be a stranger's."""

from typing import Any

import numpy as np

from tacevo.errors import DataError
from tacevo.parts.source import Catalogue, Split
from tacevo.records import Kind

#: Fields of a catalogue with an item for each label, where they are not None.
_EACH = ("pictures", "groups", "files", "places")

#: The fields of a catalogue that have one value for each picture, or none at all.
_EACH_OR_NONE = ("depths", "extents")


def check_catalogue(listed: Catalogue) -> None:
    """Check that labels, pictures, groups and names of a catalogue fit together; no picture is made.

    Raises:
        DataError: they do not; the message says which.
    """
    _require(isinstance(listed, Catalogue), "what the source lists", "a tacevo.parts.source.Catalogue", type(listed))
    _check_labels(listed)
    names, count = listed.names, len(listed.labels)
    _require(len(set(names)) == len(names), "names of the source", "names that differ", names)
    size = listed.image_size
    _require(type(size) is int and size > 0, "image_size of the source", "an integer of at least 1", size)
    for name in (*_EACH, *_EACH_OR_NONE):
        values = getattr(listed, name)
        fits = values is None or len(values) == count or (name in _EACH_OR_NONE and len(values) == 0)
        _require(fits, f"{name} of the source", f"{count}, one for each label", fits or len(values))
    if listed.groups is not None:
        _check_array(listed.groups, "groups", "int64 (N,)", np.int64, (count,))
    for split in (listed.release, listed.dealt):
        if split is not None:
            _check_split(split, count)


def check_picture(picture: Any, size: int) -> None:
    """Check that a source made a picture: an array of uint8, (3, size, size).

    Raises:
        DataError: it is something else.
    """
    shape = (3, size, size)
    if isinstance(picture, np.ndarray) and picture.dtype == np.uint8 and picture.shape == shape:
        return
    remedy, expected = f"let the source make uint8 {shape}", f"an array of uint8 {shape}"
    raise DataError(_shown(picture), place="a picture", expected=expected, remedy=remedy)


def _check_labels(listed: Catalogue) -> None:
    names, labels = listed.names, listed.labels
    if listed.kind is Kind.classification:
        _check_array(labels, "labels", "int64 (N,) of classes", np.int64, (len(labels),))
        inside = bool(((labels >= 0) & (labels < len(names))).all())
        expected = f"classes from 0 to {len(names) - 1}, one for each name"
        _require(inside, "labels of the source", expected, f"{labels.min(initial=0)} to {labels.max(initial=0)}")
        return
    _check_array(labels, "labels", f"float64 (N, {len(names)}) of values", np.float64, (len(labels), len(names)))
    _require(bool(np.isfinite(labels).all()), "labels of the source", "finite numbers", "NaN or infinity among them")
    fits = listed.units is None or len(listed.units) == len(names)
    _require(fits, "units of the source", f"{len(names)}, one for each name, or None", listed.units)


def _check_split(split: Split, count: int) -> None:
    parts = (split.train, split.validation, split.test)
    rows = np.concatenate(parts)
    whole = sorted(rows.tolist()) == list(range(count))
    rising = all(part.dtype == np.int64 and bool((np.diff(part) > 0).all()) for part in parts)
    expected = "each row in one part, of int64 and rising"
    _require(whole and rising, "the split of the source", expected, "another")


def _check_array(found: Any, name: str, expected: str, dtype: type[np.generic], shape: tuple[int, ...]) -> None:
    holds = isinstance(found, np.ndarray) and found.dtype == dtype and found.shape == shape
    _require(holds, f"{name} of the source", expected, _shown(found))


def _shown(found: Any) -> str:
    return f"{found.dtype} {found.shape}" if isinstance(found, np.ndarray) else type(found).__name__


def _require(holds: bool, place: str, expected: str, got: object) -> None:
    if not holds:
        raise DataError(str(got), place=place, expected=expected)
