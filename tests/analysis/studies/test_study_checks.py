"""Promise: a study that is not whole is refused, and every faulty row is named."""

import math
from dataclasses import replace

import pytest
from refusals import refused
from studies import network, score, study_of

from tacevo.errors import RunError
from tacevo.results.study_checks import check_study

WHOLE = study_of({"baseline": [0.1, 0.2, 0.3], "variant 1": [0.1, 0.2, 0.4]})


def test_whole_study_is_let_through() -> None:
    """Every network, every seed, once, finite."""
    check_study(WHOLE)


def test_missing_seeds_are_named() -> None:
    """Of every network that lacks some."""
    unfinished = replace(WHOLE, seeds=4, scores=WHOLE.scores[1:])
    with refused(
        RunError, got="2 faults: baseline has no score for seeds [0, 3]; variant 1 has no score for seeds [3]"
    ):
        check_study(unfinished)


def test_seeds_that_are_there_twice_or_too_many_are_named() -> None:
    """Unequal seeds, either way."""
    more = (score("variant 1", 1, {"mse": 0.1}), score("variant 1", 7, {"mse": 0.1}))
    more_than_one = "variant 1 has more than one score for seeds [1]"
    with refused(RunError, got=f"{more_than_one}; variant 1 has scores beyond the 3 seeds of the study, for seeds [7]"):
        check_study(replace(WHOLE, scores=(*WHOLE.scores, *more)))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_finite_are_named(value: float) -> None:
    """With their metric and seed, however the scores are ordered."""
    broken = study_of({"baseline": [0.1, 0.2, 0.3], "variant 1": [0.1, 0.2, value]})
    with refused(RunError, got="1 fault: variant 1 has a mse that is not finite for seeds [2]"):
        check_study(replace(broken, scores=broken.scores[::-1]))


def test_missing_metric_is_named() -> None:
    """Wherever one score has a metric that others lack."""
    scores = (*WHOLE.scores[:5], score("variant 1", 2, {"mae": 0.1}))
    with refused(RunError, got="baseline has no mae for seeds [0, 1, 2]; variant 1 has no mae for seeds [0, 1]"):
        check_study(replace(WHOLE, scores=scores))


def test_scores_of_no_network_are_refused() -> None:
    """They would be left out silently."""
    with refused(RunError, got="scores of variant 9", expected="only scores of baseline, variant 1"):
        check_study(replace(WHOLE, scores=(*WHOLE.scores, score("variant 9", 0, {"mse": 0.1}))))


@pytest.mark.parametrize(
    "names", [(), ("variant 1",), ("variant 1", "baseline"), ("baseline", "variant 1", "variant 1")]
)
def test_networks_must_be_baseline_and_variants(names: tuple[str, ...]) -> None:
    """Without a baseline, or names that tell variants apart, nobody knows what is compared."""
    with refused(RunError, expected="the baseline, then variants of different names"):
        check_study(replace(WHOLE, networks=tuple(network(name) for name in names)))
