"""Promise: a study's variants are judged by corrected tests, and "equivalent" comes from the equivalence test alone."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from refusals import refused
from scipy.stats import mannwhitneyu
from statsmodels.stats.multitest import multipletests
from studies import FOUR, around, study_of, study_of_outputs

from analysis.statistics.effects import EFFECTS
from analysis.studies.ceiling import ceiling_of
from analysis.studies.comparison import COMPARISONS, Verdict, compare, late, of_whole
from analysis.studies.warnings import Caution
from analysis.tables.comparison import scores_table, verdicts_table
from tacevo.choices import MarginKind
from tacevo.config.compose import compose
from tacevo.config.study import Margin
from tacevo.data.ideal import ideal_accuracy
from tacevo.errors import RunError
from tacevo.records import Kind
from tacevo.results.study import RecordedStudy


def verdicts(comparisons: pd.DataFrame) -> list[str]:
    """List the words, in the order of the variants."""
    words: list[str] = of_whole(comparisons).verdict.tolist()
    return words


def judged(study: RecordedStudy, *, value: float, kind: MarginKind) -> RecordedStudy:
    """State another margin of a study."""
    return replace(study, terms=replace(study.terms, margin=Margin(value=value, kind=kind)))


def test_each_verdict_has_its_case() -> None:
    """Lower errors are better, nearly equal ones are equivalent, and wide ones say nothing."""
    assert verdicts(compare(study_of(FOUR))) == list(Verdict)


def test_higher_accuracy_is_better() -> None:
    """The very same numbers as accuracies turn better and worse round."""
    accuracies = {name: [0.9 + value for value in values] for name, values in FOUR.items()}
    study = judged(study_of(accuracies, kind=Kind.classification), value=0.001, kind=MarginKind.absolute)
    assert verdicts(compare(study)) == [Verdict.worse, Verdict.better, Verdict.equivalent, Verdict.undecided]


def test_p_is_scipys_and_its_correction_statsmodels() -> None:
    """Over all variants of the study."""
    comparisons = compare(study_of(FOUR))
    baseline, *variants = FOUR.values()
    p_values = [mannwhitneyu(values, baseline, method="exact").pvalue for values in variants]
    assert comparisons.p[:2].tolist() == pytest.approx(p_values[:2])
    assert comparisons.p_holm.tolist() == pytest.approx(multipletests(comparisons.p, method="holm")[1])
    equal = multipletests(comparisons.p_equivalence, method="holm")[1]
    assert comparisons.p_equivalence_holm.tolist() == pytest.approx(equal)


#: Far worse on Fx, better on Fz; the second variant is as good as equal on both.
OUTPUTS = {
    "Fx": {
        "baseline": around(0.02, step=0.0001),
        "variant 1": around(0.03, step=0.0001),
        "variant 2": around(0.020003, step=0.0001),
    },
    "Fz": {
        "baseline": around(0.004, step=0.00004),
        "variant 1": around(0.0035, step=0.00004),
        "variant 2": around(0.004001, step=0.00004),
    },
}


def test_each_output_has_verdicts_of_its_own() -> None:
    """A variant that is worse in the mean is called better on the output where it is."""
    comparisons = compare(study_of_outputs(OUTPUTS))
    assert verdicts(comparisons) == [Verdict.worse, Verdict.equivalent]
    assert {name: variants.verdict.tolist() for name, variants in comparisons.groupby("output")} == {
        "Fx": [Verdict.worse, Verdict.equivalent],
        "Fz": [Verdict.better, Verdict.equivalent],
    }


def test_outputs_are_one_family() -> None:
    """All pairs of variant and output, because a reader may pick any; the mean's correction does not count them."""
    near = {**OUTPUTS["Fz"], "variant 1": around(0.00387, step=0.00004)}
    comparisons = compare(study_of_outputs({**OUTPUTS, "Fz": near}))
    pairs = comparisons[comparisons.output.notna()]
    p_values = [
        mannwhitneyu(values[name], values["baseline"], method="exact").pvalue
        for values in (OUTPUTS["Fx"], near)
        for name in ("variant 1", "variant 2")
    ]
    assert pairs.p.tolist() == pytest.approx(p_values)
    assert pairs.p_holm.tolist() == pytest.approx(multipletests(p_values, method="holm")[1])
    equal = multipletests(pairs.p_equivalence, method="holm")[1]
    assert pairs.p_equivalence_holm.tolist() == pytest.approx(equal)
    assert comparisons.p_holm[0] == pytest.approx(2 * comparisons.p[0])


def test_relative_margin_is_of_the_output() -> None:
    """A tenth of the baseline's median there, and not of its mean."""
    comparisons = compare(study_of_outputs(OUTPUTS))
    margins = comparisons.groupby("output").margin.first()
    assert margins[list(OUTPUTS)].tolist() == pytest.approx([0.002, 0.0004])


def test_single_output_is_the_whole() -> None:
    """A second verdict on the same numbers would say nothing."""
    assert compare(study_of_outputs({"Fx": OUTPUTS["Fx"]})).output.isna().all()


def test_output_without_an_error_is_left_out() -> None:
    """It has no relative margin, which does not keep the others from a verdict."""
    still = {name: [0.0] * 20 for name in OUTPUTS["Fx"]}
    assert set(compare(study_of_outputs({**OUTPUTS, "Fy": still})).output.dropna()) == {"Fx", "Fz"}


def test_late_trainings_are_shared_out_by_network() -> None:
    """Of 50 epochs the last tenth begins with the 46th; half of the variant's seeds chose one of these."""
    study = study_of({"baseline": around(0.01, step=0.0001), "variant 1": around(0.007, step=0.0001)})
    chosen = [replace(one, epoch=46 if one.network == "variant 1" and one.seed % 2 else 45) for one in study.scores]
    assert late(replace(study, scores=tuple(chosen))) == {"baseline": 0, "variant 1": 0.5}


def test_absence_of_evidence_is_undecided() -> None:
    """Noise of no difference at all is not called a match."""
    comparisons = compare(study_of({"baseline": around(0.01, step=0.001), "variant 1": around(0.0101, step=0.001)}))
    assert comparisons.p_holm[0] > 0.7
    assert verdicts(comparisons) == [Verdict.undecided]


def test_difference_smaller_than_the_margin_is_a_difference() -> None:
    """Shown to be there and shown to be small: better, and the equivalence stands beside it."""
    comparisons = compare(study_of({"baseline": around(0.01, step=1e-5), "variant 1": around(0.0098, step=1e-5)}))
    assert verdicts(comparisons) == [Verdict.better]
    assert comparisons.p_equivalence_holm[0] < 0.05


def test_correction_can_undo_a_verdict() -> None:
    """The same variant alone and beside three others: what is significant alone need not be in company."""
    baseline, near = around(0.01, step=0.0001), around(0.00957, step=0.0001)
    others = {f"variant {at}": around(0.01, step=0.0011 + at / 1e5) for at in (2, 3, 4)}
    assert verdicts(compare(study_of({"baseline": baseline, "variant 1": near})))[0] == Verdict.better
    assert verdicts(compare(study_of({"baseline": baseline, "variant 1": near, **others})))[0] != Verdict.better


def test_terms_are_those_of_the_study() -> None:
    """Its margin and its level decide: a wide margin makes another verdict, and so does a strict level."""
    assert compare(study_of(FOUR)).margin[0] == pytest.approx(0.001)
    accuracies = study_of({name: [0.9 + v for v in values] for name, values in FOUR.items()}, kind=Kind.classification)
    assert compare(accuracies).margin[0] == 0.01
    wide = judged(study_of(FOUR), value=0.5, kind=MarginKind.relative)
    assert compare(wide).verdict[3] == Verdict.equivalent
    strict = replace(study_of(FOUR), terms=replace(study_of(FOUR).terms, alpha=1e-6))
    assert compare(strict).verdict[2] == Verdict.undecided


def test_another_variant_changes_no_interval() -> None:
    """Each network has a random stream of its own; the global generator has no say."""
    np.random.seed(1)  # noqa: NPY002 - the global state is what must not matter
    alone = compare(study_of({name: FOUR[name] for name in ("baseline", "variant 4")}))
    np.random.seed(2)  # noqa: NPY002
    ends = list(EFFECTS)
    assert compare(study_of(FOUR)).loc[3, ends].equals(alone.loc[0, ends])


def test_few_seeds_are_named_or_refused() -> None:
    """Three seeds can never be significant; four can alone, and not among four variants."""
    few = {name: values[:4] for name, values in FOUR.items()}
    assert all(Caution.few_seeds in told for told in compare(study_of(few)).cautions)
    with refused(RunError, place="the study of force", expected="at least 4 training seeds", got="3"):
        compare(study_of({name: values[:3] for name, values in FOUR.items()}))


def test_baseline_alone_is_refused() -> None:
    """There is nothing to compare it with."""
    with refused(RunError, place="the study of force", expected="at least one variant", got="the baseline alone"):
        compare(study_of({"baseline": [0.1, 0.2, 0.3, 0.4]}))


def test_margin_relative_to_nothing_is_refused() -> None:
    """A tenth of an error of 0 is not a margin."""
    with refused(RunError, place="the baseline's median mse", got="0", remedy="margins.KIND.kind=absolute"):
        compare(study_of({"baseline": [0.0] * 5, "variant 1": [0.0, 0.1, 0.2, 0.3, 0.4]}))


@pytest.mark.parametrize(
    ("value", "kind", "is_wide"),
    [(0.01, MarginKind.absolute, True), (0.009, MarginKind.absolute, False), (0.5, MarginKind.errors, False)],
)
def test_margin_wider_than_all_errors_is_told(value: float, kind: MarginKind, is_wide: bool) -> None:
    """A baseline of 99 %: within one point of it lies a network without an error, which would be equivalent."""
    accuracies = {"baseline": around(0.99, step=0.0001), "variant 1": around(0.9905, step=0.0001)}
    study = judged(study_of(accuracies, kind=Kind.classification), value=value, kind=kind)
    (row,) = compare(study).itertuples()
    assert (Caution.wide_margin in row.cautions) == is_wide
    assert row.margin == pytest.approx(0.005 if kind is MarginKind.errors else value)


@pytest.mark.parametrize(
    ("median", "value", "images", "is_at"),
    [
        (0.93, 0.01, 100_000, False),
        (0.945, 0.01, 100_000, True),
        (0.945, 0.001, 100_000, False),
        (0.93, 0.001, 100, True),
    ],
)
def test_baseline_at_the_ceiling_is_told(median: float, value: float, images: int, is_at: bool) -> None:
    """Within the margin of 95 %, or within what chance does on few images: then no verdict can be of a large gain."""
    accuracies = {"baseline": around(median, step=1e-5), "variant 1": around(median + 0.001, step=1e-5)}
    study = judged(study_of(accuracies, kind=Kind.classification), value=value, kind=MarginKind.absolute)
    study = replace(study, data=replace(study.data, counts=(1, 1, images)))
    (unknown,), (known,) = (compare(replace(study, ceiling=ceiling)).itertuples() for ceiling in (None, 0.95))
    assert Caution.ceiling not in unknown.cautions
    assert (Caution.ceiling in known.cautions) == is_at
    assert known.verdict == unknown.verdict
    assert any("Ceiling: 95" in note for note in verdicts_table(replace(study, ceiling=0.95), compare(study)).notes)
    assert [row[0] for row in scores_table(replace(study, ceiling=0.95)).rows][-1] == "ceiling"


def test_ceiling_is_that_of_the_studied_data() -> None:
    """By the run's spacings, or those of other data; a recording and forces have none that is known."""
    study = study_of({"baseline": [0.9]}, kind=Kind.classification)
    run = compose(["experiment=demo"])
    assert ceiling_of(study, run) == ideal_accuracy(run.data.spacings_mm)
    other = replace(study, other_data=(("spacings_mm", [1.0, 1.1]),))
    assert ceiling_of(other, run) == ideal_accuracy([1.0, 1.1])
    assert ceiling_of(replace(study, other_data=(("source", "tacverse"),)), run) is None
    assert ceiling_of(study, compose(["experiment=published_force"])) is None


def test_baseline_without_errors_has_no_margin_in_errors() -> None:
    """A part of nothing is refused."""
    accuracies = {"baseline": [1.0] * 5, "variant 1": [0.9, 1.0, 1.0, 1.0, 0.8]}
    with refused(RunError, got="0", remedy="margins.KIND.kind=absolute"):
        compare(judged(study_of(accuracies, kind=Kind.classification), value=0.1, kind=MarginKind.errors))


def test_verdict_does_not_contradict_the_interval_of_its_effect() -> None:
    """Accuracies of few images tie, and then the exact test can be significant where the interval of A12 holds 0.5."""
    low, high = [0, 0, 0, 0, 1, 1, 2, 3], [1, 1, 1, 2, 2, 3, 3, 3]
    study = study_of(
        {"baseline": [one / 4 for one in low], "variant 1": [one / 4 for one in high]}, kind=Kind.classification
    )
    (variant,) = compare(study).itertuples()
    assert variant.p_holm <= 0.05
    assert variant.a12_low < 0.5
    assert variant.verdict == Verdict.undecided


@pytest.mark.parametrize("study", [study_of(FOUR), study_of_outputs(OUTPUTS)], ids=["one", "several outputs"])
def test_frame_has_the_documented_columns_and_types(study: RecordedStudy) -> None:
    """Also where no row has an output."""
    assert {name: str(kind) for name, kind in compare(study).dtypes.items()} == COMPARISONS
