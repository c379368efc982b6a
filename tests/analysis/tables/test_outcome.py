"""Promise: what a command ends with is what the records give, and no record stands without its re-estimate."""

from dataclasses import replace

import pytest
from studies import FOUR, around, estimated, study_of, study_of_outputs

from analysis.rounding import shown
from analysis.statistics.effects import median
from analysis.studies.comparison import compare
from analysis.table import Interval, Percent, PValue
from analysis.tables.comparison import scores_table
from analysis.tables.outcome import study_outcome
from tacevo.choices import MarginKind
from tacevo.config.study import Margin
from tacevo.records import Kind
from tacevo.results.study import RecordedStudy
from tacevo.rounding import rounded

ONE_DRAW = "fitness, one draw"


def identified(study: RecordedStudy) -> RecordedStudy:
    """Return a study whose candidates have ids of their own."""
    named = tuple(replace(one, id=f"id of {one.name}") for one in study.networks)
    return replace(study, networks=named)


def test_study_ends_with_its_scores_verdicts_and_re_estimates() -> None:
    """One row a network: the interval of the median, the verdict after Holm, the record beside the re-estimate."""
    study, names = identified(study_of(FOUR)), list(FOUR)
    comparisons = compare(study)
    again = estimated(names, [[0.1 * at, 0.3 * at] for at in range(1, 6)])
    table = study_outcome(study, comparisons, again, is_alone=False, trivial=None)
    rows = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    assert [row["network"] for row in rows] == names
    for row, variant in zip(rows[1:], comparisons.itertuples(), strict=True):
        equal = variant.verdict == "equivalent"  # whose word another test gave
        p, margin = (variant.p_equivalence_holm, ", margin 0.00100") if equal else (variant.p_holm, "")
        assert row["verdict (p)"] == f"{variant.verdict} ({shown(PValue(p))}{margin})"
    assert {str(row["verdict (p)"]).partition(" ")[0] for row in rows[1:]} == {
        *("better", "worse", "equivalent", "undecided")
    }
    for row in rows:
        interval = median(FOUR[str(row["network"])])
        assert row["test MSE [95 %]"] == Interval(interval.estimate, interval.low, interval.high)
    assert [row[ONE_DRAW] for row in rows] == [0.1] * 5
    assert [row["re-estimated"] for row in rows] == [0.2, 0.4, 0.6, 0.8, 1.0]


@pytest.mark.room("transfer")
def test_equivalent_network_has_the_p_and_the_margin_of_its_test() -> None:
    """Of accuracies the margin counts in points; the table of transfer and a study's figure have that p, too."""
    from analysis.tables.transfer import transfer_table

    accuracies = {name: [0.9 + value for value in values] for name, values in FOUR.items()}
    study = identified(study_of(accuracies, kind=Kind.classification))
    study = replace(study, terms=replace(study.terms, margin=Margin(value=0.001, kind=MarginKind.absolute)))
    comparisons = compare(study)
    (variant,) = (one for one in comparisons.itertuples() if one.verdict == "equivalent")
    p = shown(PValue(variant.p_equivalence_holm))
    assert p != shown(PValue(variant.p_holm))
    table = study_outcome(study, comparisons, None, is_alone=False, trivial=None)
    assert f"equivalent ({p}, margin 0.1 pt)" in {cell for row in table.rows for cell in row}
    moved = transfer_table([(study, comparisons), (study, comparisons)])
    ps = {row[4] for row in moved.rows if row[5] == "equivalent"}
    assert ps == {PValue(variant.p_equivalence_holm)}
    assert any("margin is 0.1 pt" in note for note in moved.notes)


def test_network_that_was_not_trained_again_has_an_empty_cell() -> None:
    """And not the re-estimate of its neighbour."""
    study = identified(study_of(FOUR))
    table = study_outcome(
        study,
        None,
        estimated(["baseline", "variant 3"], [[1.0, 1.0], [3.0, 3.0]]),
        is_alone=False,
        trivial=None,
    )
    assert [row[-1] for row in table.rows] == [1.0, None, None, 3.0, None]


def test_trivial_predictor_is_the_last_row() -> None:
    """With its score alone, since it has neither fitness nor verdict."""
    study = study_of({"baseline": [0.5, 0.7], "variant 1": [0.6, 0.9]}, kind=Kind.classification)
    row = study_outcome(study, None, None, is_alone=False, trivial=None).rows[-1]
    assert row == ("trivial", None, Percent(rounded(1 / 3)), None)


@pytest.mark.parametrize(
    ("values", "kind", "is_chance"),
    [
        ([0.95, 0.96], Kind.regression, True),  # of a variance of 1
        ([0.9, 0.96], Kind.regression, False),
        ([0.33, 0.36], Kind.classification, True),  # of three classes of three images each
        ([0.33, 0.4], Kind.classification, False),
    ],
)
def test_study_at_chance_says_so(values: list[float], kind: Kind, is_chance: bool) -> None:
    """Where no network's median error, or share of wrong answers, is 5 % below that of an answer without an image."""
    study = study_of({"baseline": [values[0]] * 3, "variant 1": [values[1]] * 3}, kind=kind)
    if kind is Kind.regression:
        study = study_of_outputs({"Fx": {"baseline": [values[0]] * 3, "variant 1": [values[1]] * 3}})
        scores = [replace(one, metrics={**one.metrics, "r2_Fx": 1 - one.metrics["mse"]}) for one in study.scores]
        study = replace(study, scores=tuple(scores))
    table = study_outcome(study, None, None, is_alone=False, trivial=1.5)
    for one in (table, scores_table(study)):
        assert one.notes[0].startswith("At chance: ") == is_chance
        assert one.rows[-1][0] == "trivial"
    assert table.rows[-1][-1] == 1.5


@pytest.mark.parametrize(
    ("seeds", "column"),
    [(1, "test MSE"), (2, "test MSE [least, most]"), (5, "test MSE [least, most]"), (6, "test MSE [95 %]")],
)
def test_brackets_say_what_they_hold(seeds: int, column: str) -> None:
    """Fewer than six values have no interval of 95 %, and one value has none at all."""
    study = study_of({"baseline": around(0.5, step=0.01, seeds=seeds)})
    table = study_outcome(study, None, None, is_alone=False, trivial=None)
    assert table.columns[2] == column
    assert isinstance(table.rows[0][2], float) == (seeds == 1)


def test_warnings_of_the_tables_are_a_line_each() -> None:
    """Each only where it holds: seeds that are best at the end, one split, too few seeds."""
    quick = study_of({name: values[:4] for name, values in FOUR.items()})
    last = replace(quick, scores=tuple(replace(one, epoch=quick.recipe.epochs) for one in quick.scores))
    early = replace(quick, scores=tuple(replace(one, epoch=1) for one in quick.scores))
    told = study_outcome(last, compare(last), None, is_alone=True, trivial=None).notes
    silent = study_outcome(early, compare(early), None, is_alone=False, trivial=None).notes
    for words in ("Not converged? 100.0 % of the seeds of baseline", "One split of one data set"):
        assert [sum(words in note for note in notes) for notes in (told, silent)] == [1, 0]
    many = study_outcome(study_of(FOUR), compare(study_of(FOUR)), None, is_alone=False, trivial=None).notes
    assert [sum("no result of so few seeds" in note for note in notes) for notes in (silent, many)] == [1, 0]


def test_images_of_groups_are_counted_with_them() -> None:
    """So that nobody takes the frames of a press for as many presses."""
    study = study_of(FOUR)
    grouped = replace(study, data=replace(study.data, counts=(8, 1, 6), groups=(0, 0, 1, 1, 2, 2)))
    captions = [
        study_outcome(one, None, None, is_alone=False, trivial=None).caption
        for one in (study, grouped, replace(study, lacks_groups=True))
    ]
    assert captions[0].endswith("tested on 1 image")
    assert captions[1].endswith("tested on 6 images of 3 groups")
    assert captions[2].endswith("tested on 1 image, whose groups are not recorded")
