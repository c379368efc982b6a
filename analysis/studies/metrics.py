"""Metrics as a reader knows them: their names, their units, and the order in which they are shown."""

from analysis.studies.scores import Study
from tacevo.records import Kind

#: In the order of docs/study.md; what follows an underscore is an output, as in `mse_Fx`.
_OF_VALUES = {"mse": "MSE", "mae": "MAE", "rmse": "RMSE", "r2": "R²"}

_OF_CLASSES = {"accuracy": "accuracy", "macro_f1": "macro-F1", "cross_entropy": "cross-entropy (nats)"}

#: Shares of images, which are shown as percentages.
SHARES = frozenset({"accuracy", "macro_f1"})

_RECORDED = "recorded_"


def metric_name(metric: str) -> str:
    """Name a metric of a whole task: `mse` is MSE."""
    return (_OF_VALUES | _OF_CLASSES)[metric]


def named_metrics(study: Study) -> tuple[tuple[str, str], ...]:
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
            f"{_RECORDED}{metric}_{output}": f"{_OF_VALUES[metric]} {output} ({unit or 'as recorded'})"
            for metric in ("mae", "rmse")
        }
    return tuple((metric, name) for metric, name in named.items() if metric in measured)
