"""Sources: where images and their labels come from."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from tacevo.parts.source import Catalogue, Picture, Source
from tacevo.records import Json, Kind


@dataclass(frozen=True)
class Mine(Source):
    """Bright squares, of which a network reads where they are and how large they are, as if these were forces."""

    #: The side of an image in pixels; a search sets it by `data.image_size`.
    image_size: int = 32
    #: How many; a search sets it by `data.images`.
    images: int = 200

    def describe(self) -> Json:
        """Name all that decides the images and labels; of files their bytes, and not where they lie."""
        return {"source": "Mine", "image_size": self.image_size, "images": self.images}

    def catalogue(self) -> Catalogue:
        """List labels and images; an image is made when it is needed."""
        labels = np.random.default_rng(0).uniform(0.2, 0.8, (self.images, 3))
        return Catalogue(
            kind=Kind.regression,
            names=("Fx", "Fy", "Fz"),
            labels=labels,
            image_size=self.image_size,
            pictures=[partial(self._picture, *map(float, row)) for row in labels],
        )

    def _picture(self, x: float, y: float, side: float) -> Picture:
        """Return an image of uint8 and shape (3, size, size)."""
        across = (np.arange(self.image_size) + 0.5) / self.image_size
        inside = (abs(across - x) < side / 2) & (abs(across - y) < side / 2)[:, None]
        return np.stack([np.where(inside, 200, 40).astype(np.uint8)] * 3)
