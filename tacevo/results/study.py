"""What a study found, as records: the scores of every network under every training seed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacevo.records import Kind
from tacevo.results.study_lines import Design, ScoreLine
from tacevo.results.study_terms import Terms

#: What a study is judged by: the paper's test metric of each kind of task, and whether less of it is better.
PRIMARY = {Kind.regression: "mse", Kind.classification: "accuracy"}

LOWER_IS_BETTER = {"mse": True, "accuracy": False}


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedStudy(Design):
    """A finished study: what it was to find out, and its scores."""

    #: A noise run, which has none, is not a study.
    terms: Terms
    #: Of the recording, one for each regressed value, empty where none is stated; () of a classification.
    units: tuple[str, ...]
    #: Units of the recording for one unit of training, one for each regressed value; () of a classification.
    scale: tuple[float, ...]
    #: Each is of the weights of the epoch with the lowest validation loss. Metrics are those of the test split, by
    #: name: `mse`, `mse_Fx`, `mae`, `rmse`, `r2` ...; or `accuracy`, `macro_f1`, `cross_entropy`. A confusion counts
    #: test images by (true class, predicted class).
    scores: tuple[ScoreLine, ...]

    @property
    def kind(self) -> Kind:
        """Of the task."""
        return self.data.kind

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the regressed values or classes."""
        return self.data.names

    @property
    def fingerprint(self) -> str:
        """Of the data set."""
        return self.data.fingerprint

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

    def _of(self, network: str) -> list[ScoreLine]:
        """List the scores of a network, in the order of the seeds."""
        return sorted((score for score in self.scores if score.network == network), key=lambda score: score.seed)
