"""What a study found, as records: the scores of every network under every training seed."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacevo.records import Kind, Recipe
from tacevo.studies.lines import Network
from tacevo.studies.terms import Terms

#: What a study is judged by: the paper's test metric of each kind of task, and whether less of it is better.
PRIMARY = {Kind.regression: "mse", Kind.classification: "accuracy"}

LOWER_IS_BETTER = {"mse": True, "accuracy": False}


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """One network trained fully with one seed."""

    network: str
    #: 0 to S - 1.
    seed: int
    #: The epoch of the lowest validation loss, from 1; its weights are the ones tested.
    epoch: int
    #: Of the test split, by name: `mse`, `mse_Fx`, `mae`, `rmse`, `r2` ...; or `accuracy`, `macro_f1`,
    #: `cross_entropy`.
    metrics: Mapping[str, float]
    #: Test images by (true class, predicted class); None for regression.
    confusion: tuple[tuple[int, ...], ...] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """A finished study."""

    #: Digest of the run whose elites were studied.
    run: str
    task: str
    kind: Kind
    #: Names of the regressed values or classes.
    names: tuple[str, ...]
    #: Of the recording, one for each regressed value, empty where none is stated; () of a classification.
    units: tuple[str, ...]
    #: Of the data set.
    fingerprint: str
    recipe: Recipe
    numerics: str
    #: How it is judged, stated before anything was trained.
    terms: Terms
    #: S, the training seeds of each network.
    seeds: int
    #: The baseline first, then the variants, best fitness first.
    networks: tuple[Network, ...]
    scores: tuple[Score, ...]

    @property
    def primary(self) -> str:
        """The metric that networks are compared by."""
        return PRIMARY[self.kind]

    def values(self, network: str, metric: str) -> NDArray[np.float64]:
        """Return a metric of a network, shape (S,), in the order of the seeds."""
        return np.array([score.metrics[metric] for score in self._of(network)], dtype=np.float64)

    def median_seed(self, network: str) -> int:
        """Return the seed that stands for a network: the first one whose primary metric is the median of all.

        Of an even number of seeds, the median is the lower one of the two in the middle, so that a seed has it.
        """
        ranked = sorted(self._of(network), key=lambda score: score.metrics[self.primary])
        median = ranked[(len(ranked) - 1) // 2].metrics[self.primary]
        return next(score.seed for score in self._of(network) if score.metrics[self.primary] == median)

    def _of(self, network: str) -> list[Score]:
        """List the scores of a network, in the order of the seeds."""
        return sorted((score for score in self.scores if score.network == network), key=lambda score: score.seed)
