"""What a stranger's source lists and makes is checked before anything is kept: NumPy would cast and stretch it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from greys import Greys
from refusals import refused
from small_recordings import loaded

from tacevo.errors import DataError
from tacevo.parts.source import Catalogue


@dataclass(frozen=True)
class Changed(Greys):
    """A source whose catalogue has other values."""

    values: Mapping[str, Any] = field(default_factory=dict)

    def catalogue(self) -> Catalogue:
        """Change them."""
        return replace(super().catalogue(), **self.values)


@pytest.mark.parametrize(
    ("values", "place"),
    [
        ({"labels": [[1.0]] * 20}, "labels"),
        ({"labels": np.zeros((20, 1), np.float32)}, "labels"),
        ({"labels": np.zeros(20)}, "labels"),
        ({"labels": np.full((20, 1), np.nan)}, "labels"),
        ({"names": ("grey", "grey"), "labels": np.zeros((20, 2))}, "names"),
        ({"pictures": []}, "pictures"),
        ({"groups": np.zeros(20, np.int32)}, "groups"),
        ({"groups": np.zeros(19, np.int64)}, "groups"),
        ({"units": ("N", "N")}, "units"),
        ({"image_size": 4.0}, "image_size"),
    ],
)
def test_catalogue_that_does_not_agree_is_refused(tmp_path: Path, values: dict[str, Any], place: str) -> None:
    """With the field that is wrong, and before a picture is made."""
    with refused(DataError, place=place):
        loaded(Changed(values=values), tmp_path)
    assert not list(tmp_path.rglob("*.npy"))


@pytest.mark.parametrize(
    "picture",
    [np.zeros((4, 4), np.uint8), np.zeros((3, 4, 4)), np.zeros((4, 4, 3), np.uint8), np.zeros((3, 5, 5), np.uint8), 3],
    ids=lambda picture: f"{np.shape(picture)} {np.asarray(picture).dtype}",
)
def test_picture_that_is_none_is_refused(tmp_path: Path, picture: Any) -> None:
    """A grey one would be stretched, and one between 0 and 1 would be black."""
    with refused(DataError, got="some images cannot be read", remedy="uint8 (3, 4, 4)"):
        loaded(Changed(values={"pictures": [lambda: picture] * 20}), tmp_path)
    assert not list(tmp_path.rglob("dataset.json"))
