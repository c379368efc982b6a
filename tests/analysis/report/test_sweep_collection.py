"""Promise: all runs are measured in niches over both descriptors, those of `none` where it has some."""

from hand_sweeps import finished, run_to, sweep_of
from refusals import refused

from analysis.report.sweep_collection import measuring
from tacevo.errors import IncomparableError

RUN = run_to(0.5)
ONE_AXIS = finished("one axis", 0, RUN, settings={"archive": {"axes": ["arch_div"]}})
BEST_ONLY = finished("best only", 0, RUN, settings={"archive": {"kind": "best"}})
SWEEP = sweep_of([BEST_ONLY, ONE_AXIS, finished("a", 0, RUN)])
WITH_NONE = sweep_of([*SWEEP.finished, finished("none", 0, RUN), finished("none", 1, RUN)])


def test_niches_are_those_of_none() -> None:
    """Wherever it stands in the sweep; the first of its runs has them."""
    assert measuring(WITH_NONE).job.name == "none-seed0"


def test_niches_without_none_are_those_of_a_map() -> None:
    """An archive without niches, or over one descriptor, cannot measure the others."""
    assert measuring(SWEEP).job.name == "a-seed0"


def test_sweep_without_a_map_is_refused() -> None:
    """With what to do."""
    with refused(IncomparableError, expected="an archive over both descriptors", remedy="add the arm none"):
        measuring(sweep_of([ONE_AXIS]))
