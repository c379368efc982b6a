"""The fitness of a training, made from its validation losses; lower is better (`tacevo.parts.Fitness`); pure.

The last loss of a training jumps, so a search by it selects networks that jump (docs/evidence.md).
"""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from tacevo.parts import Fitness
from tacevo.rounding import rounded


@dataclass(frozen=True)
class Last(Fitness):
    """The loss after the last epoch, which is the paper's (Algorithm 1)."""

    def of(self, losses: Sequence[float]) -> float:
        """Return the last loss."""
        return losses[-1]


@dataclass(frozen=True)
class Lowest(Fitness):
    """The lowest loss of all epochs, of whose weights a study takes its test score."""

    def of(self, losses: Sequence[float]) -> float:
        """Return the lowest loss."""
        return min(losses)


@dataclass(frozen=True)
class MeanOf3(Fitness):
    """The mean over the last three epochs, or over all of fewer."""

    def of(self, losses: Sequence[float]) -> float:
        """Return the mean of the last losses."""
        return rounded(statistics.fmean(losses[-3:]))
