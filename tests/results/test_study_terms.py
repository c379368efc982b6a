"""Promise: terms of a judgement are possible ones."""

import math

import pytest
from refusals import refused

from tacevo.choices import MarginKind
from tacevo.config.study import Margin
from tacevo.errors import RunError
from tacevo.records import Json
from tacevo.results.study_lines import StudyTerms, fewest_seeds
from tacevo.typed import convert


@pytest.mark.parametrize(
    ("margin", "width"),
    [
        (Margin(value=0.1, kind=MarginKind.relative), 0.0006),
        (Margin(value=0.1, kind=MarginKind.absolute), 0.1),
    ],
)
def test_margin_is_part_of_the_median_or_of_the_metric(margin: Margin, width: float) -> None:
    """Around the paper's median MSE of 0.006."""
    assert margin.around(0.006, is_share=False) == width


def test_margin_in_errors_is_a_part_of_what_lacks() -> None:
    """Of an accuracy to 1, so that a better baseline has a narrower one; of an error it is the relative margin."""
    tenth = Margin(value=0.1, kind=MarginKind.errors)
    assert [tenth.around(accuracy, is_share=True) for accuracy in (0.9, 0.991)] == [0.01, 0.0009]
    assert tenth.around(0.006, is_share=False) == 0.0006


def test_relative_margin_has_no_sign() -> None:
    """A metric below zero has a margin too."""
    assert Margin(value=0.5, kind=MarginKind.relative).around(-2, is_share=False) == 1


@pytest.mark.parametrize("value", [0.0, -0.1, math.nan, math.inf])
def test_margin_that_nothing_fits_in_is_refused(value: float) -> None:
    """Nor one that everything fits in."""
    with refused(RunError, place="study.json, value", expected="number"):
        convert(Margin, {"value": value, "kind": "absolute"}, place="study.json", error=RunError)


@pytest.mark.parametrize("alpha", [0.0, 1.0, -1.0, math.nan])
def test_level_out_of_range_is_refused(alpha: float) -> None:
    """A level is in the open interval."""
    terms: Json = {"alpha": alpha, "margin": {"value": 0.1, "kind": "relative"}}
    with refused(RunError, place="study.json, alpha", expected="number"):
        convert(StudyTerms, terms, place="study.json", error=RunError)


@pytest.mark.parametrize(("alpha", "seeds"), [(0.5, 2), (0.1, 3), (0.0999, 4), (0.05, 4), (0.01, 5), (0.001, 7)])
def test_fewest_seeds_are_those_that_can_be_significant(alpha: float, seeds: int) -> None:
    """Three against three have 20 orders, so p is 0.1 at least; four have 70, hence 0.029."""
    assert fewest_seeds(alpha) == seeds
