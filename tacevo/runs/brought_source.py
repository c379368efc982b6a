"""A source that a user brought, as loading sees it: other code makes the data again, and its faults are told."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

from tacevo.errors import DataError, TacevoError
from tacevo.parts.registry import Part, raised
from tacevo.parts.source import Catalogue, Picture, Source
from tacevo.parts.sources import code_files
from tacevo.records import Json
from tacevo.storage.canonical import content_hash

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
        raise DataError(
            raised(error, part.file),
            place=part.place,
            expected="images and labels",
            remedy="`tacevo parts check` tries a source",
        ) from error


def _code_of(part: Part) -> str:
    """Hash the Python files beside a part in a file, or of its package: 64 hex digits."""
    return content_hash(
        {name: hashlib.sha256(file.read_bytes()).hexdigest() for name, file in code_files(part).items()}
    )
