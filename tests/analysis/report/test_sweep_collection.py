"""Promise: all runs are measured in niches over both descriptors, those of `none` where it has some."""

import numpy as np
from hand_sweeps import finished, run_to, sweep_of
from numpy.typing import NDArray
from refusals import refused

from analysis.report.sweep_collection import measuring
from tacevo.errors import IncomparableError
from tacevo.results.run import RecordedRun

RUN = run_to(0.5)
ONE_AXIS = finished("one axis", 0, RUN, settings={"archive": {"axes": ["arch_div"]}})
SWEEP = sweep_of([finished("best only", 0, RUN), ONE_AXIS, finished("a", 0, RUN)])
WITH_NONE = sweep_of([*SWEEP.finished, finished("none", 0, RUN), finished("none", 1, RUN)])

#: Of an archive without niches, one with a single axis, and two with both.
CENTROIDS = {"best only-seed0": (0, 2), "one axis-seed0": (4, 1), "a-seed0": (4, 2), "none-seed0": (4, 2)}


def centroids_of(run: RecordedRun) -> NDArray[np.float64]:
    """Return the centroids of a run by its name."""
    return np.full(CENTROIDS[run.name], 0.5)


def test_niches_are_those_of_none() -> None:
    """Wherever it stands in the sweep; the first of its runs has them."""
    assert measuring(WITH_NONE, centroids_of)[0].job.name == "none-seed0"


def test_niches_without_none_are_those_of_a_map() -> None:
    """An archive without niches, or over one descriptor, cannot measure the others."""
    chosen, centroids = measuring(SWEEP, centroids_of)
    assert (chosen.job.name, centroids.shape) == ("a-seed0", (4, 2))


def test_sweep_without_a_map_is_refused() -> None:
    """With what to do."""
    with refused(IncomparableError, expected="an archive over both descriptors", remedy="add the arm none"):
        measuring(sweep_of([ONE_AXIS]), centroids_of)
