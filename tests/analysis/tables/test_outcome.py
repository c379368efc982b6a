"""Promise: what a command ends with is what the records give, and no record stands without its re-estimate."""

from dataclasses import replace

import pytest
from studies import FOUR, around, network, study_of, study_of_outputs

from analysis.rounding import shown
from analysis.statistics.effects import median
from analysis.studies.comparison import compare
from analysis.studies.noise import SeedNoise
from analysis.studies.reestimates import Reestimates
from analysis.table import Interval, Percent, PValue
from analysis.tables.comparison import scores_table
from analysis.tables.noise import noise_table
from analysis.tables.noise_outcome import MOST, noise_outcome
from analysis.tables.outcome import study_outcome
from tacevo.choices import MarginKind
from tacevo.config.study import Margin
from tacevo.records import Kind
from tacevo.results.study import RecordedStudy
from tacevo.rounding import rounded

ONE_DRAW = "fitness, one draw"


def reestimates(names: list[str], estimates: list[list[float]]) -> Reestimates:
    """Make re-estimates of networks whose recorded fitness was 0.1 each."""
    return Reestimates(
        name="noise",
        networks=tuple(replace(network(name), id=f"id of {name}") for name in names),
        estimates=tuple(map(tuple, estimates)),
        epochs=5,
    )


def identified(study: RecordedStudy) -> RecordedStudy:
    """Return a study whose candidates have ids of their own."""
    named = tuple(replace(one, id=f"id of {one.name}") for one in study.networks)
    return replace(study, networks=named)


def test_study_ends_with_its_scores_verdicts_and_re_estimates() -> None:
    """One row a network: the interval of the median, the verdict after Holm, the record beside the re-estimate."""
    study, names = identified(study_of(FOUR)), list(FOUR)
    comparisons = compare(study)
    again = reestimates(names, [[0.1 * at, 0.3 * at] for at in range(1, 6)])
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
        reestimates(["baseline", "variant 3"], [[1.0, 1.0], [3.0, 3.0]]),
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


def test_noise_run_stands_beside_the_trivial_loss() -> None:
    """In the last row; where no median is better by the margin, the first note says that."""
    again = reestimates(["baseline", "variant 1"], [[1.0, 1.2], [0.96, 0.98]])
    for trivial, is_chance in ((1.0, True), (1.1, False), (None, False)):
        for table in (noise_outcome(again, "force", trivial), noise_table(again, "force", trivial)):
            assert table.notes[0].startswith("At chance: ") == is_chance
            last = dict(zip(table.columns, table.rows[-1], strict=True))
            assert (last["network"] == "trivial") == (trivial is not None)
            assert trivial is None or trivial in last.values()


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


def test_noise_run_lists_the_baseline_the_winner_and_the_best_by_re_estimate() -> None:
    """On one screen, however many elites there are; what is not listed is counted."""
    names = ["baseline", *(f"variant {number}" for number in range(1, 31))]
    again = reestimates(names, [[1.0, 1.2], *([2.0 - 0.01 * at, 2.1 - 0.01 * at] for at in range(30))])
    table = noise_outcome(again, "force", None)
    listed = [row[0] for row in table.rows]
    assert listed == ["baseline", "variant 1", *names[-(MOST - 2) :]]
    assert any(f"Not listed: {31 - MOST}" in note for note in table.notes)
    winner = dict(zip(table.columns, table.rows[1], strict=True))
    assert winner[ONE_DRAW] == 0.1
    assert (winner["re-estimated"], winner["least"], winner["most"]) == (2.05, 2.0, 2.1)
    assert isinstance(winner["chance to beat the baseline [95 %]"], Interval)
    icc = SeedNoise(again).icc
    assert icc is not None
    assert table.notes[-1].startswith(f"ICC {icc.estimate:.3f} [")


def test_noise_run_of_a_baseline_alone_has_no_icc() -> None:
    """Which the note says; nothing is compared."""
    table = noise_outcome(reestimates(["baseline"], [[1.0, 1.2]]), "force", None)
    assert [row[-1] for row in table.rows] == [None]
    assert table.notes[-1].startswith("No ICC")


#: Losses of the baseline under eight other seeds.
BASELINE = [0.80, 0.81, 0.82, 0.83, 0.84, 0.85, 0.86, 0.87]


@pytest.mark.parametrize(
    ("shift", "words"),
    [
        (-0.4, "1 can be called better than the baseline, whose loss is 0.835: id of variant 1 (0.435) (medians of 8"),
        (0.005, "none can be called better than the baseline, whose loss is 0.835; 1 cannot be told from it"),
        (0.4, "none can be called better than the baseline, whose loss is 0.835; 1 worse"),
    ],
)
def test_noise_run_begins_with_its_finding(shift: float, words: str) -> None:
    """Whether the winner on record is better, worse or neither rests on the interval."""
    best = [loss + shift for loss in BASELINE]
    table = noise_outcome(reestimates(["baseline", "variant 1"], [BASELINE, best]), "force", None)
    assert table.caption.startswith(f"Of 1 elite, the best on record, {words}")
    assert table.notes[0] == "force: 2 networks, trained again as the search did, with 8 other seeds."
    assert not any("for all elites together" in note for note in table.notes)


def test_finding_of_several_names_those_that_are_better() -> None:
    """Best first by re-estimate; the others are counted, and none is left out."""
    near, far = [loss + 0.005 for loss in BASELINE], [loss + 0.4 for loss in BASELINE]
    good, best = [loss - 0.4 for loss in BASELINE], [loss - 0.5 for loss in BASELINE]
    names = ["baseline", *(f"variant {number}" for number in range(1, 5))]
    table = noise_outcome(reestimates(names, [BASELINE, good, near, far, best]), "force", None)
    assert sum("for all elites together" in note for note in table.notes) == 1
    assert table.caption == (
        "Of 4 elites, the best on record, 2 can be called better than the baseline, whose loss is 0.835: id of variant "
        "4 (0.335), id of variant 1 (0.435); 1 cannot be told from it; 1 worse (medians of 8 other seeds)."
    )
    assert noise_outcome(reestimates(names[:3], [BASELINE, near, near]), "force", None).caption.startswith(
        "Of 2 elites"
    )


def test_failed_elites_are_not_counted() -> None:
    """Neither among the best, nor silently."""
    again = replace(reestimates(["baseline", "a", "b"], [BASELINE] * 3), failed=(network("c"),))
    assert noise_outcome(again, "force", None).caption.startswith(
        "Of 2 elites, the best on record that trained with every seed, "
    )


@pytest.mark.parametrize(("seeds", "others", "is_enough"), [(5, 5, True), (5, 10, False), (3, 1, True), (2, 1, False)])
def test_too_few_seeds_are_named(seeds: int, others: int, *, is_enough: bool) -> None:
    """Where not even all wins would tell, the verdict says nothing of the networks."""
    names = ["baseline", *map(str, range(others))]
    table = noise_outcome(reestimates(names, [[1.0] * seeds, *[[0.1] * seeds] * others]), "force", None)
    assert any("cannot tell any of" in note for note in table.notes) == (not is_enough)
    assert ("none can be called better" in table.caption) == (not is_enough)


def test_more_networks_need_more_evidence() -> None:
    """What is better alone is not, where it is one of many that might have been lucky."""
    wins = [loss - 0.04 for loss in BASELINE]
    clear = noise_outcome(reestimates(["baseline", "a"], [BASELINE, wins]), "force", None).caption
    names = ["baseline", *map(str, range(50))]
    crowded = noise_outcome(reestimates(names, [BASELINE, *[wins] * 50]), "force", None).caption
    assert "1 can be called better" in clear
    assert "none can be called better" in crowded


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
