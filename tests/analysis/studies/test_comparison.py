"""Promise: a study's variants are judged by corrected tests, and "equivalent" comes from the equivalence test alone."""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refused
from scipy.stats import mannwhitneyu
from statsmodels.stats.multitest import multipletests
from studies import FOUR, around, study_of, study_of_outputs

from analysis.studies.comparison import Comparisons, Verdict, compare
from analysis.studies.scores import Study
from analysis.studies.warnings import Caution
from tacevo.choices import MarginKind
from tacevo.config.study import Margin
from tacevo.errors import RunError
from tacevo.records import Kind


def verdicts(found: Comparisons) -> list[Verdict]:
    """List the words, in the order of the variants."""
    return [variant.verdict for variant in found.variants]


def judged(study: Study, *, value: float, kind: MarginKind) -> Study:
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
    found = compare(study_of(FOUR))
    baseline, *variants = FOUR.values()
    p_values = [mannwhitneyu(values, baseline, method="exact").pvalue for values in variants]
    assert [variant.test.p for variant in found.variants[:2]] == pytest.approx(p_values[:2])
    corrected = multipletests([variant.test.p for variant in found.variants], method="holm")[1]
    assert [variant.p_holm for variant in found.variants] == pytest.approx(corrected)
    equal = multipletests([variant.equivalence.p for variant in found.variants], method="holm")[1]
    assert [variant.equivalence_p_holm for variant in found.variants] == pytest.approx(equal)


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
    found = compare(study_of_outputs(OUTPUTS))
    assert verdicts(found) == [Verdict.worse, Verdict.equivalent]
    assert {name: [one.verdict for one in variants] for name, variants in found.outputs.items()} == {
        "Fx": [Verdict.worse, Verdict.equivalent],
        "Fz": [Verdict.better, Verdict.equivalent],
    }


def test_outputs_are_one_family() -> None:
    """All pairs of variant and output, because a reader may pick any; the mean's correction does not count them."""
    near = {**OUTPUTS["Fz"], "variant 1": around(0.00387, step=0.00004)}
    found = compare(study_of_outputs({**OUTPUTS, "Fz": near}))
    pairs = [one for variants in found.outputs.values() for one in variants]
    p_values = [
        mannwhitneyu(values[name], values["baseline"], method="exact").pvalue
        for values in (OUTPUTS["Fx"], near)
        for name in ("variant 1", "variant 2")
    ]
    assert [one.test.p for one in pairs] == pytest.approx(p_values)
    assert [one.p_holm for one in pairs] == pytest.approx(multipletests(p_values, method="holm")[1])
    equal = [one.equivalence.p for one in pairs]
    assert [one.equivalence_p_holm for one in pairs] == pytest.approx(multipletests(equal, method="holm")[1])
    assert found.variants[0].p_holm == pytest.approx(2 * found.variants[0].test.p)


def test_relative_margin_is_of_the_output() -> None:
    """A tenth of the baseline's median there, and not of its mean."""
    found = compare(study_of_outputs(OUTPUTS))
    margins = [found.outputs[name][0].equivalence.margin for name in OUTPUTS]
    assert margins == pytest.approx([0.002, 0.0004])


def test_single_output_is_the_whole() -> None:
    """A second verdict on the same numbers would say nothing."""
    assert compare(study_of_outputs({"Fx": OUTPUTS["Fx"]})).outputs == {}


def test_output_without_an_error_is_left_out() -> None:
    """It has no relative margin, which does not keep the others from a verdict."""
    still = {name: [0.0] * 20 for name in OUTPUTS["Fx"]}
    assert list(compare(study_of_outputs({**OUTPUTS, "Fy": still})).outputs) == ["Fx", "Fz"]


def test_late_trainings_are_shared_out_by_network() -> None:
    """Of 50 epochs the last tenth begins with the 46th; half of the variant's seeds chose one of these."""
    study = study_of({"baseline": around(0.01, step=0.0001), "variant 1": around(0.007, step=0.0001)})
    late = [replace(one, epoch=46 if one.network == "variant 1" and one.seed % 2 else 45) for one in study.scores]
    assert compare(replace(study, scores=tuple(late))).late == {"baseline": 0, "variant 1": 0.5}


def test_test_image_is_the_step_of_an_accuracy() -> None:
    """Of 9 images one is a ninth; an error has no such step."""
    accuracies = study_of({name: [0.9 + v for v in values] for name, values in FOUR.items()}, kind=Kind.classification)
    assert compare(accuracies).image == pytest.approx(1 / 9)
    assert compare(study_of(FOUR)).image is None


def test_absence_of_evidence_is_undecided() -> None:
    """Noise of no difference at all is not called a match."""
    found = compare(study_of({"baseline": around(0.01, step=0.001), "variant 1": around(0.0101, step=0.001)}))
    assert found.variants[0].p_holm > 0.7
    assert verdicts(found) == [Verdict.undecided]


def test_difference_smaller_than_the_margin_is_a_difference() -> None:
    """Shown to be there and shown to be small: better, and the equivalence stands beside it."""
    found = compare(study_of({"baseline": around(0.01, step=1e-5), "variant 1": around(0.0098, step=1e-5)}))
    assert verdicts(found) == [Verdict.better]
    assert found.variants[0].equivalence_p_holm < 0.05


def test_correction_can_undo_a_verdict() -> None:
    """The same variant alone and beside three others: what is significant alone need not be in company."""
    baseline, near = around(0.01, step=0.0001), around(0.00957, step=0.0001)
    others = {f"variant {at}": around(0.01, step=0.0011 + at / 1e5) for at in (2, 3, 4)}
    assert verdicts(compare(study_of({"baseline": baseline, "variant 1": near})))[0] is Verdict.better
    assert verdicts(compare(study_of({"baseline": baseline, "variant 1": near, **others})))[0] is not Verdict.better


def test_terms_are_those_of_the_study() -> None:
    """Its margin and its level decide: a wide margin makes another verdict, and so does a strict level."""
    assert compare(study_of(FOUR)).variants[0].equivalence.margin == pytest.approx(0.001)
    accuracies = study_of({name: [0.9 + v for v in values] for name, values in FOUR.items()}, kind=Kind.classification)
    assert compare(accuracies).variants[0].equivalence.margin == 0.01
    wide = judged(study_of(FOUR), value=0.5, kind=MarginKind.relative)
    assert compare(wide).variants[3].verdict is Verdict.equivalent
    strict = replace(study_of(FOUR), terms=replace(study_of(FOUR).terms, alpha=1e-6))
    assert compare(strict).variants[2].verdict is Verdict.undecided


def test_another_variant_changes_no_interval() -> None:
    """Each network has a random stream of its own; the global generator has no say."""
    np.random.seed(1)  # noqa: NPY002 - the global state is what must not matter
    alone = compare(study_of({name: FOUR[name] for name in ("baseline", "variant 4")}))
    np.random.seed(2)  # noqa: NPY002
    assert compare(study_of(FOUR)).variants[3].effects == alone.variants[0].effects
    assert compare(study_of(FOUR), seed=1).variants[3].effects != alone.variants[0].effects


def test_few_seeds_are_named_or_refused() -> None:
    """Three seeds can never be significant; four can alone, and not among four variants."""
    few = {name: values[:4] for name, values in FOUR.items()}
    assert all(Caution.few_seeds in variant.cautions for variant in compare(study_of(few)).variants)
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


def test_verdict_does_not_contradict_the_interval_of_its_effect() -> None:
    """Accuracies of few images tie, and then the exact test can be significant where the interval of A12 holds 0.5."""
    low, high = [0, 0, 0, 0, 1, 1, 2, 3], [1, 1, 1, 2, 2, 3, 3, 3]
    study = study_of(
        {"baseline": [one / 4 for one in low], "variant 1": [one / 4 for one in high]}, kind=Kind.classification
    )
    (variant,) = compare(study).variants
    assert variant.p_holm <= 0.05
    assert variant.effects.a12.low < 0.5
    assert variant.verdict is Verdict.undecided
