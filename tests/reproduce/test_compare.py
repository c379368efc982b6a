"""Promise: two runs are called equal only where their ledgers are, and else the first difference is named."""

from dataclasses import replace
from typing import Any

import pytest
from ledger_lines import candidate, ended, header, trained

from tacevo.evolution.files import Line, RunLine
from tacevo.reproduce.compare import Compared, agreement, compare, describe, fitness_by_source

HEADER = header()


def recorded(*lines: Line, first: RunLine = HEADER, **changes: Any) -> Compared:
    """Make a run to be compared."""
    run = Compared(
        config={"seed": 0, "archive": {}},
        has_niches=True,
        lines=(first, *lines),
        elites={0: "source 00", 4: "source 01"},
    )
    return replace(run, **changes)


CANDIDATES = (trained("g01s00", 0.1), trained("g01s01", 0.2), trained("g01s02", 0.3), candidate("g01s03"))

RUN = recorded(*CANDIDATES, ended(1, best=0.1))


def test_run_equals_itself() -> None:
    """Nothing differs, and all of it is said to be equal."""
    found = compare(RUN, RUN)
    assert found.is_equal
    assert describe(found).startswith("the ledgers are equal: 6 lines\n")


def test_first_difference_names_place_field_and_both_values() -> None:
    """A later difference, and the hashes that follow from the first one, do not hide it."""
    other = recorded(
        *CANDIDATES[:1], trained("g01s01", 0.25), trained("g01s02", 0.9), *CANDIDATES[3:], ended(1, best=0.1)
    )
    found = compare(RUN, other)
    assert not found.is_equal
    assert found.equal == 2
    assert str(found.divergence) == (
        "generation 1, slot 1: field 'fitness' is 0.2 in the first run and 0.25 in the second"
    )
    assert found.decision is None


def test_beginning_of_a_run_is_not_the_run() -> None:
    """A shorter ledger differs although no line of it does."""
    longer = recorded(*RUN.lines[1:], ended(2, best=0.05))
    found = compare(RUN, longer)
    assert found.divergence is None
    assert not found.is_equal
    assert "the second run goes on where the other ends" in describe(found)
    assert "the first run goes on where the other ends" in describe(compare(longer, RUN))


def test_difference_behind_other_headers_is_named_too() -> None:
    """Runs of other settings differ in their headers; where their decisions part is what one wants to know."""
    other = recorded(*CANDIDATES[:2], trained("g01s02", 0.4), ended(1), first=header(config={"seed": 1}))
    found = compare(RUN, other)
    assert found.equal == 0
    assert found.divergence is not None
    assert found.divergence.field == "config.seed"
    assert found.decision is not None
    assert (found.decision.place, found.decision.field) == ("generation 1, slot 2", "fitness")


def test_settings_that_differ_are_listed_but_not_where_the_runs_lie() -> None:
    """A directory's name is not a difference between runs."""
    one = replace(RUN, config={**RUN.config, "llm": {"model": "a"}, "run": {"dir": "x"}, "store": {"root": "y"}})
    other = replace(RUN, config={**RUN.config, "llm": {"model": "b"}, "run": {"dir": "z"}, "store": {"root": "w"}})
    (setting,) = compare(one, other).settings
    assert (setting.field, setting.values) == ("llm.model", ('"a"', '"b"'))


def test_agreement_is_that_of_equal_sources_only() -> None:
    """By hand: of three shared sources one is equal, the others are 0.1 and 0.3 apart."""
    found = agreement({"a": 1.0, "b": 2.0, "c": 3.0, "d": 9.0}, {"a": 1.0, "b": 2.1, "c": 3.3, "e": 0.0})
    assert (found.shared, found.same) == (3, 1)
    assert found.largest == pytest.approx(0.3)
    assert found.median == pytest.approx(0.1)


def test_rejected_candidate_has_no_fitness_to_compare() -> None:
    """Only what was trained counts."""
    assert fitness_by_source(RUN.lines) == {"source 00": 0.1, "source 01": 0.2, "source 02": 0.3}


def test_runs_without_a_source_in_common_agree_in_nothing() -> None:
    """No difference of 0, which would look like agreement."""
    found = compare(RUN, recorded(trained("g01s07", 0.1), *RUN.lines[4:]))
    assert "no source was trained in both runs" in describe(found)


def test_archives_overlap_by_source_and_by_niche() -> None:
    """By hand: niche 0 holds the same source, niche 4 another, and a source moved from niche 4 to 5."""
    found = compare(RUN, replace(RUN, elites={0: "source 00", 4: "source 02", 5: "source 01"})).overlap
    assert (found.elites, found.sources, found.niches) == ((2, 3), 2, (2, 1))


def test_niches_of_other_centroids_are_not_compared() -> None:
    """Niche 4 of one tessellation is not niche 4 of another."""
    found = compare(RUN, recorded(*RUN.lines[1:], first=header(centroids="d")))
    assert found.overlap.niches is None
    assert "niches are not compared: the runs have different ones" in describe(found)


def test_places_of_the_best_are_not_compared() -> None:
    """Without niches, place 0 of one run has nothing to do with place 0 of another; shared sources still count."""
    best = replace(RUN, has_niches=False)
    found = compare(best, best)
    assert (found.overlap.niches, found.overlap.sources) == (None, 2)
    assert "niches are not compared" in describe(found)
