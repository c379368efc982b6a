"""A source of grey pictures, and what a cache then shows."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from tacevo.data.source import Catalogue, Picture
from tacevo.data.splitting import ordered_split
from tacevo.errors import DataError
from tacevo.records import Json, Kind


def grey(value: int) -> Picture:
    """Make a picture of one grey value."""
    return np.full((3, 4, 4), value, dtype=np.uint8)


def broken(name: str) -> Picture:
    """Fail as a damaged image file does."""
    raise DataError(name)


@dataclass(frozen=True)
class Greys:
    """A source of grey pictures whose label is their grey value times a step."""

    count: int = 20
    kind: Kind = Kind.regression
    names: tuple[str, ...] = ("grey",)
    broken: int = 0
    groups: tuple[int, ...] | None = None
    released: bool = False
    step: float = 1.0

    def describe(self) -> Json:
        """Name the content."""
        return {"source": "greys", "count": self.count, "broken": self.broken, "step": self.step}

    def catalogue(self) -> Catalogue:
        """List the pictures; the first few may be broken."""
        good = [partial(grey, value % 256) for value in range(self.broken, self.count)]
        labels = np.arange(self.count, dtype=np.float64).reshape(-1, 1) * self.step
        classes = np.arange(self.count) * len(self.names) // self.count
        return Catalogue(
            kind=self.kind,
            names=self.names,
            labels=classes if self.kind is Kind.classification else labels,
            groups=None if self.groups is None else np.array(self.groups),
            release=ordered_split(np.arange(self.count)) if self.released else None,
            image_size=4,
            pictures=[*[partial(broken, f"{number}.png") for number in range(self.broken)], *good],
        )


def entries(cache: Path) -> list[Path]:
    """List what a reader of the cache can see."""
    return [path for path in cache.iterdir() if not path.name.startswith(".")]
