"""Promise: a study's variants are judged by corrected tests, and "equivalent" comes from the equivalence test alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import mannwhitneyu
from statsmodels.stats.multitest import multipletests
from studies import FOUR, around, study_of

from analysis.cautions import Caution
from analysis.comparison import Comparisons, Verdict, compare
from analysis.results import Study
from tacevo.choices import MarginKind
from tacevo.errors import RunError
from tacevo.records import Kind
from tacevo.terms import Margin


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


def test_order_of_scores_does_not_matter() -> None:
    """Scores are found by network and seed, not by their place."""
    study = study_of(FOUR)
    assert compare(replace(study, scores=study.scores[::-1])) == compare(study)


def test_few_seeds_are_named_or_refused() -> None:
    """Three seeds can never be significant; four can alone, and not among four variants."""
    few = {name: values[:4] for name, values in FOUR.items()}
    assert all(Caution.few_seeds in variant.cautions for variant in compare(study_of(few)).variants)
    with pytest.raises(RunError, match=r"at alpha 0\.05 needs at least 4 training seeds .* the study of force has 3"):
        compare(study_of({name: values[:3] for name, values in FOUR.items()}))


def test_power_is_told_for_one_test_and_for_holms_strictest() -> None:
    """Four variants: a quarter of alpha."""
    found = compare(study_of(FOUR))
    assert found.detectable is not None
    assert found.detectable_holm is not None
    assert (found.detectable.alpha, found.detectable_holm.alpha) == (0.05, 0.0125)


def test_baseline_alone_is_refused() -> None:
    """There is nothing to compare it with."""
    with pytest.raises(RunError, match="needs a variant beside the baseline; the study of force has none"):
        compare(study_of({"baseline": [0.1, 0.2, 0.3, 0.4]}))


def test_margin_relative_to_nothing_is_refused() -> None:
    """A tenth of an error of 0 is no margin."""
    with pytest.raises(
        RunError, match=r"baseline's median mse is 0, .* state an absolute one by .* margins.KIND.kind=absolute"
    ):
        compare(study_of({"baseline": [0.0] * 5, "variant 1": [0.0, 0.1, 0.2, 0.3, 0.4]}))
