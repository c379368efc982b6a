"""Promise: the tables of a study say what its comparison found, how it was found, and what to beware of."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
from studies import FOUR, in_text, network, score, study_of

from analysis.comparison import compare
from analysis.comparison_tables import (
    effects_table,
    metric_name,
    metrics_table,
    scores_table,
    study_tables,
    verdicts_table,
)
from analysis.results import Study
from analysis.tables import Between, Percent
from tacevo.errors import RunError
from tacevo.records import Kind

GOLDEN = Path(__file__).parent / "golden"
STUDY = study_of(FOUR)


def test_tables_of_a_study_are_golden() -> None:
    """All four, with their notes, unrounded; another bit in any figure would show."""
    expected = (GOLDEN / "study_tables.txt").read_text(encoding="utf-8")
    assert "\n".join(in_text(table) for table in study_tables(STUDY, compare(STUDY))) == expected


def test_scores_are_quartiles_by_hand() -> None:
    """Of 1 to 5: the median 3 between 2 and 4, from 1 to 5."""
    table = scores_table(study_of({"baseline": [5, 1, 4, 2, 3], "variant 1": [1, 1, 1, 1, 1]}))
    assert table.rows[0][3:] == (3, 2, 4, 1, 5)
    assert table.rows[1][3:] == (1, 1, 1, 1, 1)


def test_accuracies_are_percentages() -> None:
    """As the paper prints them."""
    accuracies = study_of({"baseline": [0.5] * 5, "variant 1": [0.9, 0.8, 0.9, 1.0, 1.0]}, kind=Kind.classification)
    assert scores_table(accuracies).rows[1][3:] == tuple(map(Percent, (0.9, 0.9, 1.0, 0.8, 1.0)))
    assert [row[1] for row in verdicts_table(accuracies, compare(accuracies)).rows] == [Percent(0.5), Percent(0.9)]


def with_metrics(**metrics: float) -> Study:
    """Make a study of two networks and seeds whose scores all have these metrics."""
    names = ("baseline", "variant 1")
    scores = tuple(score(name, seed, metrics) for name in names for seed in (0, 1))
    return replace(STUDY, seeds=2, networks=tuple(map(network, names)), scores=scores)


def test_every_metric_has_its_column() -> None:
    """By the names that readers know."""
    table = metrics_table(with_metrics(mse=0.25, mse_Fx=0.5, r2=0.9, rmse=0.5))
    assert table.columns == ("network", "MSE", "MSE Fx", "R²", "RMSE")
    assert table.rows[0] == ("baseline", *(Between(value, value, value) for value in (0.25, 0.5, 0.9, 0.5)))


@pytest.mark.parametrize(
    ("metric", "name"), [("mse", "MSE"), ("mae_Fz", "MAE Fz"), ("macro_f1", "macro-F1"), ("accuracy", "accuracy")]
)
def test_metrics_are_named_for_readers(metric: str, name: str) -> None:
    """Abbreviations in capitals, axes apart, words as they are."""
    assert metric_name(metric) == name


def test_metric_that_is_not_finite_is_refused() -> None:
    """In any column, not in the primary one alone."""
    with pytest.raises(RunError, match=r"baseline has a r2 that is not finite for seeds \[0, 1\]"):
        metrics_table(with_metrics(mse=0.25, r2=math.nan))


def test_unfinished_study_has_no_scores_table() -> None:
    """Quartiles of the seeds that happen to be there would mislead."""
    with pytest.raises(RunError, match=r"variant 4 has no score for seeds \[19\]"):
        scores_table(replace(STUDY, scores=STUDY.scores[:-1]))


def test_cautions_name_their_networks_once() -> None:
    """One note for each caution, with all networks that it concerns."""
    notes = verdicts_table(STUDY, compare(STUDY)).notes
    assert sum(note.startswith("variant 1, variant 2: the samples do not overlap") for note in notes) == 1
    assert sum(note.startswith("variant 4: the quartiles lie more than twice") for note in notes) == 1


def test_direction_of_a12_is_told() -> None:
    """For errors below a half is better, for accuracies above."""
    accuracies = study_of({name: [0.9 + v for v in values] for name, values in FOUR.items()}, kind=Kind.classification)
    assert "below 0.5 the variant is the better one" in effects_table(STUDY, compare(STUDY)).notes[1]
    assert "above 0.5 the variant is the better one" in effects_table(accuracies, compare(accuracies)).notes[1]


def test_seeds_that_detect_nothing_are_told() -> None:
    """Four seeds reach no power of 80 % at all."""
    few = study_of({name: values[:4] for name, values in FOUR.items()})
    assert "4 seeds detect no effect at all in a single test" in effects_table(few, compare(few)).notes[2]
