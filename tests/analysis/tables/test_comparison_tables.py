"""Promise: the tables of a study say what its comparison found, how it was found, and what to beware of."""

from dataclasses import replace

import pytest
from studies import FOUR, around, in_text, study_of, study_of_outputs
from syrupy.assertion import SnapshotAssertion

from analysis.studies.comparison import compare
from analysis.table import Interval, Percent, PercentInterval
from analysis.tables.comparison import (
    effects_table,
    metrics_table,
    outputs_table,
    scores_table,
    study_tables,
    verdicts_table,
)
from analysis.tables.rendering import as_markdown
from tacevo.choices import MarginKind
from tacevo.config.study import Margin
from tacevo.records import Kind

STUDY = study_of(FOUR)


def test_tables_of_a_study_are_golden(recorded_text: SnapshotAssertion) -> None:
    """All four, with their notes, unrounded; another bit in any figure would show."""
    assert "\n".join(in_text(table) for table in study_tables(STUDY, compare(STUDY))) == recorded_text


def test_scores_are_quartiles_by_hand() -> None:
    """Of 1 to 5: the median 3 between 2 and 4, from 1 to 5."""
    table = scores_table(study_of({"baseline": [5, 1, 4, 2, 3], "variant 1": [1, 1, 1, 1, 1]}))
    assert table.rows[0][4:9] == (3, 2, 4, 1, 5)
    assert table.rows[1][4:9] == (1, 1, 1, 1, 1)


def test_u_keeps_its_half() -> None:
    """By hand: of 400 pairs the variant has the larger value in 309 and the same in 13, so U is 309 + 13 / 2."""
    first, second = [at / 100 for at in range(20)], [(at + 7) / 100 for at in range(20)]
    study = study_of({"baseline": first, "variant 1": second}, kind=Kind.classification)
    assert "| 315.5 |" in as_markdown(verdicts_table(study, compare(study)))


def test_accuracy_has_one_face() -> None:
    """A percentage in scores and metrics, percentage points where it is a difference or a margin."""
    study = study_of({"baseline": [0.5] * 5, "variant 1": [0.9, 0.8, 0.9, 1.0, 1.0]}, kind=Kind.classification)
    comparisons = compare(study)
    rows = (("accuracy", PercentInterval(0.5, 0.5, 0.5), PercentInterval(0.9, 0.9, 1.0), Percent(0.333333333)),)
    assert metrics_table(study).rows == rows
    effects = effects_table(study, comparisons)
    assert effects.columns[-1] == "difference of medians (percentage points)"
    assert effects.rows[0][-1] == Interval(40, 30, 50)
    assert "a margin of 1.00 percentage points, as" in verdicts_table(study, comparisons).notes[1]


def test_difference_below_the_margin_is_told() -> None:
    """A network may be better and equivalent in one study: a note names it, and no other."""
    study = study_of(
        {name: around(middle, step=1e-5) for name, middle in (("baseline", 0.95), ("near", 0.952), ("far", 0.98))},
        kind=Kind.classification,
    )
    (note,) = (note for note in verdicts_table(study, compare(study)).notes if note.startswith("Equivalent by the"))
    assert "near (better)." in note
    assert not any(note.startswith("Equivalent by the") for note in verdicts_table(STUDY, compare(STUDY)).notes)


def test_margin_below_a_test_image_is_told() -> None:
    """One point of 9 images; two ninths are more than an image, and need no word; an error has no such step."""
    accuracies = study_of({name: [0.9 + v for v in values] for name, values in FOUR.items()}, kind=Kind.classification)
    wide = replace(accuracies, terms=replace(accuracies.terms, margin=Margin(value=2 / 9, kind=MarginKind.absolute)))
    words = "The margin of equivalence is less than one test image, 11.1 percentage points:"
    assert any(note.startswith(words) for note in verdicts_table(accuracies, compare(accuracies)).notes)
    for study in (wide, STUDY):
        assert not any("one test image" in note for note in verdicts_table(study, compare(study)).notes)


def test_margin_below_a_group_of_test_images_is_told() -> None:
    """One point of 9 images that are 3 presses: a network that errs on a press more lies outside it."""
    accuracies = study_of({name: [0.9 + v for v in values] for name, values in FOUR.items()}, kind=Kind.classification)
    presses = replace(accuracies.data, counts=(8, 1, 9), groups=(0, 0, 0, 1, 1, 1, 2, 2, 2))
    study = replace(accuracies, data=presses)
    words = "The margin of equivalence is less than one test group, on average 33.3 percentage points:"
    assert any(note.startswith(words) for note in verdicts_table(study, compare(study)).notes)


def test_outputs_have_a_table() -> None:
    """A row for each network on each output, and the family in a note; of one output there is no such table."""
    wide, narrow = around(0.02, step=0.0001), around(0.004, step=0.0001)
    study = study_of_outputs(
        {"Fx": {"baseline": wide, "variant 1": narrow}, "Fz": {"baseline": narrow, "variant 1": wide}}
    )
    comparisons = compare(study)
    table = outputs_table(study, comparisons)
    assert [row[:3] for row in table.rows] == [
        ("Fx", "baseline", 0.02),
        ("Fx", "variant 1", 0.004),
        ("Fz", "baseline", 0.004),
        ("Fz", "variant 1", 0.02),
    ]
    assert [row[-1] for row in table.rows] == [None, "better", None, "worse"]
    assert "corrected after Holm over all 2 pairs of output and variant" in table.notes[1]
    assert study_tables(study, comparisons)[-1] == table
    assert any("mean over the outputs" in note for note in verdicts_table(study, comparisons).notes)
    assert "outputs" not in [table.name for table in study_tables(STUDY, compare(STUDY))]


def test_errors_of_outputs_are_in_recorded_units() -> None:
    """Squared, as the column says; the comparison does not depend on the unit."""
    near, far = around(0.02, step=0.0001), around(0.03, step=0.0001)
    study = study_of_outputs({name: {"baseline": near, "variant 1": far} for name in ("Fx", "yaw_deg")})
    units = replace(study, units=("N", "deg"), scale=(10.0, 3.0))
    plain, table = (outputs_table(one, compare(one)) for one in (study, units))
    assert table.columns[2] == "median (MSE, Fx N², yaw deg²)"
    factors = [{"Fx": 100, "yaw_deg": 9}[str(row[0])] for row in plain.rows]
    assert [row[2] for row in table.rows] == pytest.approx(
        [factor * float(str(row[2])) for factor, row in zip(factors, plain.rows, strict=True)]
    )
    assert [row[3:] for row in table.rows] == [row[3:] for row in plain.rows]


def test_output_that_is_not_compared_is_named() -> None:
    """Without an error of the baseline there is no relative margin, and the table says why the output is missing."""
    near, still = around(0.02, step=0.0001), [0.0] * 20
    each = {"Fx": near, "Fy": still, "Fz": near}
    study = study_of_outputs({name: {"baseline": values, "variant 1": values} for name, values in each.items()})
    assert any(note.startswith("Not compared on Fy:") for note in outputs_table(study, compare(study)).notes)
