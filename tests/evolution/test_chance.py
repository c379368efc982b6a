"""Promise: a search in which nothing was learned, or nothing found, says so and says what to raise."""

import math

import pytest

from tacevo.evolution.chance import MARGIN, chance_in_words, is_at_chance, shortfall

LN10 = math.log(10)
SETTINGS = ("training.epochs", "data.images", "training.learning_rate", "search.candidates", "llm.model")


@pytest.mark.parametrize(
    ("best", "trivial", "expected"),
    [
        (2.301, LN10, True),
        (LN10 + 1, LN10, True),
        ((1 - MARGIN) * LN10, LN10, True),
        ((1 - MARGIN) * LN10 - 1e-9, LN10, False),
        (0.0, 0.0, True),  # one class only: nothing can be below
        (0.01, None, False),
        (None, LN10, False),
    ],
)
def test_chance_is_all_that_is_not_below_the_trivial_loss_by_the_margin(
    best: float | None, trivial: float | None, expected: bool
) -> None:
    """What is not known is not called chance."""
    assert is_at_chance(best, trivial) is expected


@pytest.mark.parametrize(("best", "baseline"), [(2.301, 2.303), (2.303, 2.303), (1.946, 1.946)])
def test_shortfall_names_what_to_raise(best: float, baseline: float) -> None:
    """Epochs, images, learning rate, candidates and model, whichever of both it is."""
    said = shortfall(best=best, baseline=baseline, trivial=LN10, asked=True, usable=True)
    assert [one for one in SETTINGS if one not in said] == []
    assert (chance_in_words(LN10) in said) == is_at_chance(best, LN10)
    beaten = shortfall(best=best, baseline=best + 1, trivial=LN10, asked=True, usable=True)
    assert (said == beaten) == (best < baseline)


@pytest.mark.parametrize(
    ("best", "baseline", "trivial"), [(1.0, 1.5, LN10), (1.0, None, LN10), (1.0, math.nan, LN10), (2.301, 2.303, None)]
)
def test_search_that_found_something_has_no_shortfall(
    best: float, baseline: float | None, trivial: float | None
) -> None:
    """Nor one of an earlier release that beat its baseline; a baseline that is not known is not said to be unbeaten."""
    assert shortfall(best=best, baseline=baseline, trivial=trivial, asked=True, usable=True) == ""


def test_networks_that_nobody_was_asked_for_beat_nothing() -> None:
    """A study of a baseline alone has no search that could have been larger; chance is chance."""
    assert shortfall(best=1.0, baseline=1.0, trivial=LN10, asked=False, usable=False) == ""
    assert "search." not in shortfall(best=2.3, baseline=2.3, trivial=LN10, asked=False, usable=False)


def test_answers_that_cannot_be_used_are_told_as_such() -> None:
    """More epochs would not help; the baseline alone was trained."""
    said = shortfall(best=1.0, baseline=1.0, trivial=LN10, asked=True, usable=False)
    assert "llm.model" in said
    assert "training.epochs" not in said
