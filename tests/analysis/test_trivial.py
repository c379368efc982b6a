"""Promise: every table of scores says what a predictor reaches that looks at no image."""

from dataclasses import replace

import numpy as np
import pytest
from sklearn.dummy import DummyRegressor
from sklearn.metrics import mean_squared_error
from studies import study_of

from analysis.studies.scores import Study
from analysis.studies.trivial import trivial_score
from analysis.table import Percent
from analysis.tables.comparison import scores_table
from tacevo.records import Kind
from tacevo.training.metrics import regression_metrics

ACCURACIES = study_of({"baseline": [0.5, 0.6]}, kind=Kind.classification)


def regression(labels: np.ndarray, predictions: np.ndarray) -> Study:
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


def test_mean_is_scikit_learns_dummy() -> None:
    """Of three outputs with variances of their own, from scores of predictions that have nothing to do with it."""
    rng = np.random.default_rng(0)
    labels = (rng.normal(size=(40, 3)) * [1, 5, 0.1]).astype(np.float32)
    dummy = DummyRegressor().fit(labels, labels).predict(labels)
    study = regression(labels, rng.normal(size=(40, 3)).astype(np.float32))
    assert trivial_score(study) == pytest.approx(mean_squared_error(labels, dummy), rel=1e-6)


def test_perfect_predictions_do_not_tell_the_variance() -> None:
    """An R² of 1 has no error to compare with; nor has a study without metrics of its outputs."""
    labels = np.random.default_rng(0).normal(size=(5, 3)).astype(np.float32)
    assert trivial_score(regression(labels, labels)) is None
    alone = study_of({"baseline": [0.1, 0.2]})
    assert trivial_score(alone) is None
    assert len(scores_table(alone).rows) == 1
