"""Promise: a study that is not whole is refused, with its rows (others: test_analysis_studies.py)."""

from dataclasses import replace

import pytest
from refusals import refused
from studies import network, study_of

from tacevo.errors import RunError
from tacevo.results.study import check_study

WHOLE = study_of({"baseline": [0.1, 0.2, 0.3], "variant 1": [0.1, 0.2, 0.4]})


def test_whole_study_is_let_through() -> None:
    """Every network, every seed, once, in whatever order."""
    check_study(replace(WHOLE, scores=WHOLE.scores[::-1]))


@pytest.mark.parametrize(
    "names", [(), ("variant 1",), ("variant 1", "baseline"), ("baseline", "variant 1", "variant 1")]
)
def test_networks_must_be_baseline_and_variants(names: tuple[str, ...]) -> None:
    """Without a baseline, or names that tell variants apart, nobody knows what is compared."""
    with refused(RunError, expected="the baseline, then variants of different names"):
        check_study(replace(WHOLE, networks=tuple(network(name) for name in names)))
