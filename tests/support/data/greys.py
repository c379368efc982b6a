"""A source of grey pictures, and what a cache then shows."""

from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path

import numpy as np

from tacevo.data.splitting import ordered_split
from tacevo.errors import DataError
from tacevo.parts.source import Catalogue, Picture
from tacevo.records import Json, Kind


def grey(value: int, size: int) -> Picture:
    """Make a picture of one grey value."""
    return np.full((3, size, size), value, dtype=np.uint8)


def broken(name: str) -> Picture:
    """Fail as a damaged image file does."""
    raise DataError(name)


@dataclass(frozen=True)
class Greys:
    """A source of pictures whose grey value is their row; their label is that times a step, where none is given."""

    count: int = 20
    kind: Kind = Kind.regression
    names: tuple[str, ...] = ("grey",)
    broken: int = 0
    groups: tuple[int, ...] | None = None
    released: bool = False
    step: float = 1.0
    labels: tuple[tuple[float, ...], ...] | None = None
    units: tuple[str, ...] | None = None
    size: int = 4

    def describe(self) -> Json:
        """Name the content."""
        return {"source": "greys", **{field.name: str(getattr(self, field.name)) for field in fields(self)}}

    def catalogue(self) -> Catalogue:
        """List the pictures; the first few may be broken."""
        count = self.count if self.labels is None else len(self.labels)
        good = [partial(grey, value % 256, self.size) for value in range(self.broken, count)]
        classes = np.arange(count) * len(self.names) // count
        values = np.arange(count, dtype=np.float64).reshape(-1, 1) * self.step
        return Catalogue(
            kind=self.kind,
            names=self.names,
            labels=classes
            if self.kind is Kind.classification
            else values
            if self.labels is None
            else np.array(self.labels),
            units=self.units,
            groups=None if self.groups is None else np.array(self.groups),
            release=ordered_split(np.arange(count)) if self.released else None,
            image_size=self.size,
            pictures=[*[partial(broken, f"{number}.png") for number in range(self.broken)], *good],
        )


def entries(cache: Path) -> list[Path]:
    """List what a reader of the cache can see."""
    return [path for path in cache.iterdir() if not path.name.startswith(".")]
