"""Promise: every metric that a study measures is shown, in the documented order, by a reader's name and its unit."""

from dataclasses import replace

import numpy as np
import pytest
from studies import score, study_of

from analysis.studies.metric_names import named_metrics
from tacevo.records import Kind
from tacevo.results.study import RecordedStudy
from tacevo.training.metrics import classification_metrics, regression_metrics

NAMES = ("Fx", "Fy", "shear_yaw")


def measured(*units: str) -> RecordedStudy:
    """Return a regression whose scores have the metrics that the training measures, sorted as a file has them."""
    values = np.random.default_rng(0).random((2, 5, 3)).astype(np.float32)
    metrics = regression_metrics(values[0], values[1], names=NAMES, scale=(1.0, 2.0, 3.0))
    study = study_of({"baseline": [0.1]})
    return replace(
        study,
        data=replace(study.data, names=NAMES),
        units=units,
        scores=(score("baseline", 0, dict(sorted(metrics.items()))),),
    )


def test_metrics_of_a_regression_stand_in_the_order_of_the_docs() -> None:
    """Over all outputs, of each output, and in the units of the recording."""
    assert [name for _, name in named_metrics(measured("N", "mN", "deg"))] == [
        *("MSE", "MAE", "RMSE", "R²"),
        *("MSE Fx", "MAE Fx", "RMSE Fx", "R² Fx"),
        *("MSE Fy", "MAE Fy", "RMSE Fy", "R² Fy"),
        *("MSE shear_yaw", "MAE shear_yaw", "RMSE shear_yaw", "R² shear_yaw"),
        *("MAE Fx (N)", "RMSE Fx (N)", "MAE Fy (mN)", "RMSE Fy (mN)"),
        *("MAE shear_yaw (deg)", "RMSE shear_yaw (deg)"),
    ]


@pytest.mark.parametrize("units", [(), ("", "", "")])
def test_unit_that_nobody_states_is_not_made_up(units: tuple[str, ...]) -> None:
    """It is that of the recording, whatever that was."""
    assert named_metrics(measured(*units))[-1] == ("recorded_rmse_shear_yaw", "RMSE shear_yaw (as recorded)")


def test_no_metric_is_left_out() -> None:
    """What is measured has a name, once, of either kind of task."""
    regression = measured("N", "N", "deg")
    counted = classification_metrics(np.eye(3, dtype=np.float32), np.arange(3))
    classification = study_of({"baseline": [0.1]}, kind=Kind.classification)
    for study in (regression, replace(classification, scores=(score("baseline", 0, counted),))):
        named = named_metrics(study)
        assert {metric for metric, _ in named} == study.scores[0].metrics.keys()
        assert len({name for _, name in named}) == len(named)
