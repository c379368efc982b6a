"""Fitness: what a training is worth; lower is better."""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from tacevo.parts import Fitness


@dataclass(frozen=True)
class Mine(Fitness):
    """The median loss of the last epochs."""

    #: How many.
    epochs: int = 3

    def of(self, losses: Sequence[float]) -> float:
        """Return a finite number of the validation losses, one an epoch."""
        return median(losses[-self.epochs :])
