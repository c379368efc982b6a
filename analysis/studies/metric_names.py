"""Metrics as a reader knows them: their names, their units, and the order in which they are shown."""

from tacevo.data.labels import plain_name
from tacevo.records import Kind
from tacevo.results.study import RecordedStudy

#: In the order of docs/study.md; what follows an underscore is an output, as in `mse_Fx`.
_OF_VALUES = {"mse": "MSE", "mae": "MAE", "rmse": "RMSE", "r2": "R²"}

_OF_CLASSES = {"accuracy": "accuracy", "macro_f1": "macro-F1", "cross_entropy": "cross-entropy (nats)"}

#: Shares of images, which are shown as percentages.
SHARES = frozenset({"accuracy", "macro_f1"})

_RECORDED = "recorded_"

#: Stands for a unit that the recording does not state.
_UNKNOWN = "as recorded"


def metric_name(metric: str) -> str:
    """Name a metric of a whole task: `mse` is MSE."""
    return (_OF_VALUES | _OF_CLASSES)[metric]


def recorded_scale(study: RecordedStudy) -> dict[str, float]:
    """Return the units of the recording for one unit of training, by regressed value."""
    return dict(zip(study.names, study.scale or [1.0] * len(study.names), strict=True))


def recorded_unit(study: RecordedStudy) -> str:
    """Name the unit of squared errors of each value, for the head of a column: `N²`, or `depth mm², roll deg²`."""
    units = [f"{unit}²" if unit else _UNKNOWN for unit in study.units or [""] * len(study.names)]
    if len(set(units)) == 1:
        return units[0]
    plain = map(plain_name, study.names, study.units)
    return ", ".join(f"{name} {unit}" for name, unit in zip(plain, units, strict=True))


def named_metrics(study: RecordedStudy) -> tuple[tuple[str, str], ...]:
    """List the metrics of a study with their names, in the order of docs/study.md.

    `mse_Fx` is `MSE Fx`, in the scaled units of training; `recorded_mae_Fx` is `MAE Fx (N)`, in the recording's.

    Returns:
        The metric and its name, of every metric that the scores have.
    """
    measured = study.scores[0].metrics
    if study.kind is Kind.classification:
        return tuple((metric, name) for metric, name in _OF_CLASSES.items() if metric in measured)
    named = dict(_OF_VALUES)
    for output in study.names:
        named |= {f"{metric}_{output}": f"{name} {output}" for metric, name in _OF_VALUES.items()}
    for output, unit in zip(study.names, study.units or [""] * len(study.names), strict=True):
        named |= {
            f"{_RECORDED}{metric}_{output}": f"{_OF_VALUES[metric]} {output} ({unit or _UNKNOWN})"
            for metric in ("mae", "rmse")
        }
    return tuple((metric, name) for metric, name in named.items() if metric in measured)
