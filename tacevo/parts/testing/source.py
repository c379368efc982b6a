"""The promises of a source of images."""

import dataclasses
import shutil
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from tacevo.data.agreement import check_catalogue, check_picture
from tacevo.parts.source import Catalogue
from tacevo.parts.testing.contract import Contract, require
from tacevo.storage.canonical import canonical

#: The number of pictures of a source that are made, at most.
_PICTURES = 32

#: The largest recording that is copied elsewhere, in bytes.
_COPIED = 200_000_000


def source_contracts(source: Any) -> list[Contract]:
    """List what a source promises."""
    tested = _Tested(source)
    return [
        Contract("describes itself in JSON, and alike each time", tested.describes),
        Contract("describes files by their bytes, and not by where they lie", tested.names_bytes),
        Contract("lists labels, pictures, groups and names that fit together", tested.fits),
        Contract("lists the same again", tested.lists_again),
        Contract("makes pictures of uint8 and shape (3, size, size)", tested.makes),
        Contract("makes the same picture again, in any order and in several threads", tested.makes_again),
    ]


class _Tested:
    """A source and its catalogue."""

    def __init__(self, source: Any) -> None:
        self._source = source
        self._listed: Catalogue | None = None

    def describes(self) -> None:
        """Twice, and so does another source of the same settings."""
        first = canonical(self._source.describe())
        require(canonical(self._source.describe()) == first, first, canonical(self._source.describe()))
        again = canonical(dataclasses.replace(self._source).describe())
        require(again == first, f"{first}, as of a source of the same settings", again)

    def names_bytes(self) -> None:
        """A copy of what lies at `root` has the same description."""
        root: Any = getattr(self._source, "root", None)
        if root is None or sum(each.stat().st_size for each in _files(Path(root))) > _COPIED:
            return
        path = Path(root)
        with tempfile.TemporaryDirectory() as folder:
            copied = Path(folder) / path.resolve().name
            (shutil.copytree if path.is_dir() else shutil.copy)(path, copied)
            moved = dataclasses.replace(self._source, root=type(root)(copied))
            first, second = canonical(self._source.describe()), canonical(moved.describe())
        require(first == second, f"{first} of a copy in another directory", second)

    def fits(self) -> None:
        """A catalogue agrees with itself."""
        check_catalogue(self._catalogue())
        require(len(self._catalogue().labels) > 0, "at least one image", "none")

    def lists_again(self) -> None:
        """The order does not depend on the day."""
        first, second = self._catalogue(), self._source.catalogue()
        for name in ("kind", "names", "units", "image_size", "places", "files", "skipped"):
            one, other = getattr(first, name), getattr(second, name)
            require(one == other, f"the same {name} twice", f"{one}, then {other}")
        for name in ("labels", "groups"):
            require(_equal(getattr(first, name), getattr(second, name)), f"the same {name} twice", "others")

    def makes(self) -> None:
        """Some pictures, the first and the last among them."""
        listed = self._catalogue()
        for row in _some(len(listed.pictures)):
            check_picture(listed.pictures[row](), listed.image_size)

    def makes_again(self) -> None:
        """Here in their order, and then by threads in the other."""
        listed = self._catalogue()
        rows = _some(len(listed.pictures))
        first = {row: np.array(listed.pictures[row]()) for row in rows}
        with ThreadPoolExecutor(4) as pool:
            again = dict(zip(reversed(rows), pool.map(lambda row: listed.pictures[row](), reversed(rows)), strict=True))
        differing = [row for row in rows if not np.array_equal(first[row], again[row])]
        require(not differing, "the same pictures again", f"others in rows {differing}")

    def _catalogue(self) -> Catalogue:
        if self._listed is None:
            self._listed = self._source.catalogue()
        return self._listed


def _some(count: int) -> list[int]:
    """Return rows from the first to the last."""
    return sorted({round(number) for number in np.linspace(0, count - 1, min(count, _PICTURES))})


def _equal(first: Any, second: Any) -> bool:
    return first is second is None or (first is not None and second is not None and np.array_equal(first, second))


def _files(path: Path) -> Iterator[Path]:
    return (each for each in path.rglob("*") if each.is_file()) if path.is_dir() else iter([path])
