"""Archives: where the niches of the network archive are."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from tacevo.parts import Archive


@dataclass(frozen=True)
class Mine(Archive):
    """Niches that are spread evenly without a random draw: the points of a Kronecker sequence."""

    def centroids(self, niches: int, axes: int) -> Sequence[Sequence[float]]:
        """Return a point of the unit cube for each niche."""
        slopes = [math.sqrt((axis + 1) ** 2 + 1) for axis in range(axes)]
        return [[number * slope % 1 for slope in slopes] for number in range(1, niches + 1)]
