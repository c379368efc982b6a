"""Promise: every table of scores says what a predictor reaches that looks at no image."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binomtest
from sklearn.dummy import DummyRegressor
from sklearn.metrics import f1_score, log_loss, mean_squared_error
from studies import study_of

from analysis.statistics.effects import effects_of_constant
from analysis.studies.comparison import compare
from analysis.table import Interval, Percent
from analysis.tables.comparison import effects_table, metrics_table, outputs_table, scores_table, verdicts_table
from tacevo.records import Kind
from tacevo.results.study import RecordedStudy
from tacevo.results.trivial import trivial_metrics, trivial_score
from tacevo.rounding import rounded
from tacevo.training.metrics import regression_metrics

ACCURACIES = study_of({"baseline": [0.5, 0.6]}, kind=Kind.classification)


def regression(labels: np.ndarray, predictions: np.ndarray) -> RecordedStudy:
    """Make a study of one network and two seeds from labels and predictions of three outputs."""
    names = ("Fx", "Fy", "Fz")
    metrics = regression_metrics(predictions, labels, names=names, scale=(1.0, 2.0, 3.0))
    study = study_of({"baseline": [metrics["mse"]] * 2})
    return replace(study, scores=tuple(replace(score, metrics=metrics) for score in study.scores))


def test_majority_is_the_most_frequent_class() -> None:
    """Three of nine images in every class of the matrix; and a row of the table, with neither cost nor spread."""
    assert trivial_score(ACCURACIES) == pytest.approx(1 / 3)
    skewed = replace(ACCURACIES, scores=tuple(replace(one, confusion=((1, 0), (2, 6))) for one in ACCURACIES.scores))
    share = trivial_score(skewed)
    assert share == pytest.approx(8 / 9)
    assert scores_table(skewed).rows[-1] == ("trivial", None, 0, 0, Percent(share or 0), *(None,) * 5)


def test_effects_compare_it_with_the_baseline() -> None:
    """One constant against twenty seeds: the share of them below it, by Wilson; the distance from their median."""
    seeds = [0.2 + at / 100 for at in range(20)]
    study = study_of({"baseline": seeds, "variant 1": seeds[::-1]})
    measured = {name: 1.0 for axis in "xyz" for name in (f"mse_F{axis}",)} | {f"r2_F{axis}": -1.0 for axis in "xyz"}
    study = replace(study, scores=tuple(replace(one, metrics={**one.metrics, **measured}) for one in study.scores))
    assert trivial_score(study) == 0.5
    table = effects_table(study, compare(study))
    ends = binomtest(20, 20).proportion_ci(0.95, method="wilson")
    name, a12, delta, difference = table.rows[-1]
    assert name == "trivial"
    assert a12 == Interval(1, rounded(ends.low), 1)
    assert delta == Interval(1, rounded(2 * ends.low - 1), 1)
    assert difference == Interval(0.205, rounded(0.5 - 0.34), rounded(0.5 - 0.25))
    assert any("Trivial: looks at no image" in note for note in table.notes)
    silent = study_of({"baseline": seeds, "variant 1": seeds[::-1]})
    assert [row[0] for row in effects_table(silent, compare(silent)).rows] == ["variant 1"]


def test_constant_that_ties_counts_a_half() -> None:
    """As in every A12; in the middle of a sample it is not an effect."""
    measures = effects_of_constant(3, [1, 2, 3, 4, 5])
    assert (measures["a12"], measures["cliffs_delta"], measures["difference"]) == (0.5, 0, 0)
    assert measures["a12_low"] == pytest.approx(1 - measures["a12_high"])
    with pytest.raises(ValueError, match="not finite"):
        effects_of_constant(3, [1, np.nan])


@pytest.mark.parametrize("n", [21, 22, 36, 42, 51, 59])
def test_interval_of_a_constant_stays_among_chances(n: int) -> None:
    """Where Wilson's end is 0 or 1, the subtraction leaves a last bit beyond it for these sizes."""
    below, above = effects_of_constant(0, range(1, n + 1)), effects_of_constant(n + 1, range(1, n + 1))
    assert (below["a12_low"], below["cliffs_delta_low"]) == (0, -1)
    assert (above["a12_high"], above["cliffs_delta_high"]) == (1, 1)


def test_mean_is_scikit_learns_dummy() -> None:
    """Of three outputs with variances of their own, from scores of predictions that have nothing to do with it."""
    rng = np.random.default_rng(0)
    labels = (rng.normal(size=(40, 3)) * [1, 5, 0.1]).astype(np.float32)
    dummy = DummyRegressor().fit(labels, labels).predict(labels)
    study = regression(labels, rng.normal(size=(40, 3)).astype(np.float32))
    assert trivial_score(study) == pytest.approx(mean_squared_error(labels, dummy), rel=1e-6)


def test_metrics_are_scikit_learns_of_a_dummy() -> None:
    """All that scores tell of it, in the recording's units too; absolute errors they do not tell."""
    rng = np.random.default_rng(0)
    labels = rng.normal(size=(40, 3)).astype(np.float32)
    metrics = trivial_metrics(regression(labels, rng.normal(size=(40, 3)).astype(np.float32)))
    means = np.tile(labels.astype(np.float64).mean(axis=0), (40, 1)).astype(np.float32)
    expected = regression_metrics(means, labels, names=("Fx", "Fy", "Fz"), scale=(1.0, 2.0, 3.0))
    assert metrics == pytest.approx({name: expected[name] for name in metrics}, rel=1e-5, abs=1e-6)
    assert {"mse", "rmse", "r2", "recorded_rmse_Fz"} <= metrics.keys()
    assert "mae" not in metrics


def test_metrics_of_a_majority_are_scikit_learns() -> None:
    """Always the most frequent class; the cross-entropy is that of the frequencies."""
    counts, truth = ((1, 0), (2, 6)), [0] + [1] * 8
    skewed = replace(ACCURACIES, scores=tuple(replace(one, confusion=counts) for one in ACCURACIES.scores))
    metrics = trivial_metrics(skewed)
    assert metrics["macro_f1"] == pytest.approx(f1_score(truth, [1] * 9, average="macro"))
    assert metrics["cross_entropy"] == pytest.approx(log_loss(truth, np.tile([1 / 9, 8 / 9], (9, 1))))


def test_trivial_stands_in_every_table_of_scores() -> None:
    """Beside the networks, on each output, with neither a test nor an interval."""
    rng = np.random.default_rng(0)
    labels = rng.normal(size=(40, 3)).astype(np.float32)
    study = regression(labels, rng.normal(size=(40, 3)).astype(np.float32))
    networks = tuple(replace(study.networks[0], name=name) for name in ("baseline", "variant 1"))
    rows = tuple(replace(study.scores[0], network=one.name, seed=seed) for one in networks for seed in range(4))
    study = replace(study, networks=networks, scores=rows, seeds=4)
    comparisons = compare(study)
    assert metrics_table(study).columns[-1] == "trivial"
    assert [row[1] for row in verdicts_table(study, comparisons).rows if row[0] == "trivial"] == [trivial_score(study)]
    apart = [row[2] for row in outputs_table(study, comparisons).rows if row[1] == "trivial"]
    assert apart == pytest.approx(labels.var(axis=0), rel=1e-5)


def test_perfect_predictions_do_not_tell_the_variance() -> None:
    """An R² of 1 has no error to compare with; nor has a study without metrics of its outputs."""
    labels = np.random.default_rng(0).normal(size=(5, 3)).astype(np.float32)
    assert trivial_score(regression(labels, labels)) is None
    alone = study_of({"baseline": [0.1, 0.2]})
    assert trivial_score(alone) is None
    assert len(scores_table(alone).rows) == 1
