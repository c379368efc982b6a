"""A source that a user brought, as loading sees it: other code makes the data again, and its faults are told."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from traceback import extract_tb
from typing import TypeVar

from tacevo.errors import DataError, TacevoError
from tacevo.parts.registry import Part
from tacevo.parts.source import Catalogue, Picture, Source
from tacevo.records import Json

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class BroughtSource:
    """A source whose description holds the code that it comes from, beside what it says of itself."""

    part: Part
    source: Source

    def describe(self) -> Json:
        """Return the key of the cached data set: what was made by other code is not taken from there."""
        described = _blaming(self.part, self.source.describe)
        return {"described": described, "code": _code_of(self.part)}

    def catalogue(self) -> Catalogue:
        """List labels and pictures; raises DataError, whatever the source raises."""
        listed = _blaming(self.part, self.source.catalogue)
        return replace(listed, pictures=[partial(self._picture, picture) for picture in listed.pictures])

    def _picture(self, picture: Callable[[], Picture]) -> Picture:
        return _blaming(self.part, picture)


def _blaming(part: Part, call: Callable[[], T]) -> T:
    """Call a method of a source, and name the source and its line where that raises."""
    try:
        return call()
    except TacevoError:
        raise
    except Exception as error:
        frames = extract_tb(error.__traceback__)
        own = [frame for frame in frames if part.file is not None and Path(frame.filename).name == part.file.name]
        last = (own or frames)[-1]
        raise DataError(
            f"{type(error).__name__}: {error} ({Path(last.filename).name}, line {last.lineno})",
            place=part.place,
            expected="images and labels",
            remedy="`tacevo parts check` tries a source",
        ) from error


def _code_of(part: Part) -> str:
    """Hash the Python files beside a part in a file, or of its package: 64 hex digits."""
    if part.file is not None:
        folder, files = part.file.parent, sorted(part.file.parent.glob("*.py"))
    else:
        spec = find_spec(part.module.partition(".")[0])
        origin = Path(spec.origin) if spec is not None and spec.origin is not None else Path()
        is_package = spec is not None and bool(spec.submodule_search_locations)
        folder = origin.parent
        files = sorted(folder.rglob("*.py")) if is_package else [origin]
    whole = hashlib.sha256()
    for file in files:
        whole.update(f"{file.relative_to(folder)}\n{hashlib.sha256(file.read_bytes()).hexdigest()}\n".encode())
    return whole.hexdigest()
