"""The worth of a run's recorded fitnesses, by the re-estimates of one of its studies or noise runs."""

from dataclasses import dataclass
from functools import cached_property

import pandas as pd

from analysis.statistics.seed_noise import agreement, icc, noise, rankings, worth
from analysis.studies.reestimates import Reestimates
from analysis.table import Interval


@dataclass(frozen=True, eq=False)
class SeedNoise:
    """The noise of the fitnesses that a run recorded, by their re-estimates."""

    again: Reestimates

    @cached_property
    def frame(self) -> pd.DataFrame:
        """Each network and its id, its record beside its re-estimates (`analysis.statistics.seed_noise.NOISE`)."""
        frame = noise([network.fitness for network in self.again.networks], self.again.estimates)
        frame.insert(0, "network", [network.name for network in self.again.networks])
        frame.insert(1, "candidate", [network.id for network in self.again.networks])
        return frame

    @cached_property
    def icc(self) -> Interval | None:
        """The part of the variance of one fitness that is the network's; None where it is not defined."""
        return icc(self.again.estimates)

    @property
    def agreement(self) -> float | None:
        """Kendall's tau of the recorded fitnesses and the medians of the re-estimates; None without two to rank."""
        return agreement(self.frame.recorded, self.frame["median"])

    @property
    def rankings(self) -> pd.DataFrame | None:
        """The ranking of the networks after each epoch, beside their test scores (`RANKINGS`); None without curves."""
        curves = self.again.curves
        return None if curves is None else rankings(curves.fitness, curves.tested)

    @property
    def worth(self) -> pd.DataFrame | None:
        """The worth of a fitness after the search's epochs, by each rule (`WORTH`); None without curves."""
        curves = self.again.curves
        return None if curves is None else worth(curves.losses[:, :, : self.again.epochs], curves.tested)
