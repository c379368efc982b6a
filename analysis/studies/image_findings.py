"""Findings on a study's networks from its test images: ensembles of the seeds, and the variants on each output.

The verdicts of `analysis.studies.comparison` resample seeds only: they hold for these test images. Here images are
resampled with the seeds, and the ensembles of the seeds, which are the networks as one would use them, are compared on
the same images. Of images that were recorded together each group counts once, where groups are known. Predictions are
read from the store of the study, and compared with its scores.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.statistics.image_statistics import (
    Floats,
    average,
    drawn_again,
    mean_difference,
    predicted,
    probabilities,
    resampled_means,
    signed_rank,
    squared_errors,
)
from analysis.statistics.tests import holm
from analysis.studies.comparison import Verdict
from analysis.table import Interval
from tacevo.errors import RunError
from tacevo.randomness import stream
from tacevo.records import Kind, Mode
from tacevo.results.study import RecordedStudy
from tacevo.results.study_lines import fewest_seeds
from tacevo.rounding import rounded
from tacevo.storage.array_store import KIND, ArrayStore
from tacevo.storage.store import Store
from tacevo.text import listed
from tacevo.training.full import read_kept, score

#: The group of each test image, shape (t,), numbered from 0.
Groups = NDArray[np.int64]

#: Returns the difference of two networks, with its interval over seeds and groups of images.
Differ = Callable[[str, str], Interval]


#: The columns of an interval.
_DIFFERENCE = dict.fromkeys(("difference", "difference_low", "difference_high"), "float64")

#: The columns of a study's ensembles, and the type of each, a network a row, the baseline first. The score, of the
#: primary metric, is that of the mean of the seeds' predictions: of outputs, or of the classes' probabilities. The
#: difference is the mean primary metric of the seeds less the baseline's, over seeds and images; missing of itself.
ENSEMBLES = {"network": "str", "score": "float64"} | _DIFFERENCE

#: The columns of a regression's variants on its outputs, and the type of each, by output, then variant. `better` and
#: `worse` count groups of images, each image where none are known, by the ensembles' squared errors, `lead` is as of
#: `signed_rank`, `p_holm` is corrected over all rows, and the difference is the mean squared error of the seeds less
#: the baseline's, over seeds and groups. The verdict is never `equivalent`, for which there is no test here; `better`
#: and `worse` take the test and the interval, so that neither stands beside an interval that holds 0. Missing of fewer
#: seeds than a comparison takes.
OUTPUTS = (
    {"output": "str", "network": "str", "better": "int64", "worse": "int64"}
    | dict.fromkeys(("lead", "p", "p_holm"), "float64")
    | _DIFFERENCE
    | {"verdict": "str"}
)

#: The two frames that test images give: `ENSEMBLES` and `OUTPUTS`; without rows where there is nothing of the second.
ImageFindings = tuple[pd.DataFrame, pd.DataFrame]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Predictions:
    """The predictions of every network of a study for the t test images, under each of its S seeds."""

    #: The predictions by network, in the order of the study: float32, shape (S, t, K), in the scaled units of training,
    #: or logits.
    of: Mapping[str, NDArray[np.float32]]
    #: Float32, shape (t, K), in the same units; of a classification int64, shape (t,).
    labels: NDArray[Any]


def load_predictions(study: RecordedStudy, store: Path) -> Predictions | None:
    """Read the test predictions of a study.

    Args:
        study: whose scores name them.
        store: the directory of the stores.

    Returns:
        None where the study keeps none, as one of an earlier release.

    Raises:
        RunError: some trainings name predictions and others do not, their labels differ, or they do not give the
            recorded score; the message names the row.
        CacheMissError: the store lacks some.
        StoreError: an entry of the store is damaged.
    """
    kept = [one.kept for one in study.scores]
    if not any(kept):
        return None
    labels = {None if one is None else one.labels for one in kept}
    if len(labels) > 1:
        digests = listed("none" if each is None else each[:12] for each in sorted(labels, key=str))
        expected = "the same test labels in every training"
        raise RunError(f"labels of the digests {digests}", place=f"the study of {study.task}", expected=expected)
    arrays = ArrayStore(Store(store, KIND, Mode.replay))
    by_network: dict[str, list[NDArray[np.float32]]] = {network.name: [] for network in study.networks}
    truth: NDArray[Any] = np.empty(0)
    unit = [1.0] * len(study.names)  # that of training, as the primary metric's
    for row in sorted(study.scores, key=lambda row: row.seed):
        if row.kept is not None:
            predictions, truth = read_kept(arrays, row.kept, study.data)
            metrics, _ = score(study.kind, predictions, truth, names=study.names, scale=unit)
            recorded, computed = row.metrics[study.primary], metrics[study.primary]
            if recorded != computed:
                place = f"{row.network}, seed {row.seed}, {study.primary}"
                raise RunError(str(recorded), place=place, expected=f"{computed}, by its test predictions")
            by_network[row.network].append(predictions)
    return Predictions(of={name: np.stack(each) for name, each in by_network.items()}, labels=truth)


def image_findings(study: RecordedStudy, predictions: Predictions) -> ImageFindings:
    """Compare the networks of a study on its test images.

    All networks share the draws of the groups of images, and each has draws of its seeds from a stream of its own, so
    another variant changes no interval.
    """
    if study.kind is Kind.classification:
        return _of_classes(study, predictions)
    return _of_values(study, predictions)


def _of_classes(study: RecordedStudy, predictions: Predictions) -> ImageFindings:
    labels = predictions.labels
    right = {name: (each.argmax(axis=2) == labels).astype(np.float64) for name, each in predictions.of.items()}
    ensembles = {name: average([probabilities(one) for one in each]) for name, each in predictions.of.items()}
    scores = {name: int((predicted(mean) == labels).sum()) / len(labels) for name, mean in ensembles.items()}
    return _ensembles(study, scores, _differences(right, "accuracy", _groups(study, len(labels)))), _frame([], OUTPUTS)


def _of_values(study: RecordedStudy, predictions: Predictions) -> ImageFindings:
    labels: Floats = predictions.labels.astype(np.float64)
    errors = {name: np.stack([squared_errors(one, labels) for one in each]) for name, each in predictions.of.items()}
    ensembles = {name: average(list(each)) for name, each in predictions.of.items()}
    scores = {name: fmean(squared_errors(mean, labels)) for name, mean in ensembles.items()}
    outputs = _outputs(study, predictions, ensembles) if len(study.names) > 1 else []
    differ = _differences(errors, "mse", _groups(study, len(labels)))
    return _ensembles(study, scores, differ), _frame(outputs, OUTPUTS)


def _groups(study: RecordedStudy, images: int) -> Groups:
    """Return the group of each test image; where none are known, each image is one."""
    return np.array(study.data.groups or range(images), dtype=np.int64)


def _outputs(study: RecordedStudy, predictions: Predictions, ensembles: Mapping[str, Floats]) -> list[dict[str, Any]]:
    """Compare every variant with the baseline on each output; all of these are one family."""
    baseline, *variants = (network.name for network in study.networks)
    groups = _groups(study, len(predictions.labels))
    rows: list[dict[str, Any]] = []
    for at, output in enumerate(study.names):
        labels = predictions.labels[:, at : at + 1]
        errors = {
            name: np.stack([squared_errors(one[:, at : at + 1], labels) for one in each])
            for name, each in predictions.of.items()
        }
        means = {name: squared_errors(mean[:, at : at + 1], labels) for name, mean in ensembles.items()}
        differ = _differences(errors, f"mse_{output}", groups)
        for name in variants:
            test = signed_rank(means[name], means[baseline], groups)
            rows.append({"output": output, "network": name} | test | differ(name, baseline).columns("difference"))
    for row, p in zip(rows, holm([row["p"] for row in rows]) if rows else (), strict=True):
        row |= {"p_holm": p, "verdict": _verdict(study, row, is_shown=p <= study.terms.alpha)}
    return rows


def _differences(scores: Mapping[str, Floats], metric: str, groups: Groups) -> Differ:
    """Return what gives the mean score of a network less another's, with its interval over seeds and groups."""
    weights = drawn_again(int(groups.max()) + 1, rng=stream(0, "images"))[:, groups]
    drawn = {
        name: resampled_means(each, weights, rng=stream(0, "seeds", name, metric)) for name, each in scores.items()
    }
    return lambda one, other: mean_difference(scores[one], scores[other], drawn[one], drawn[other])


def _ensembles(study: RecordedStudy, scores: Mapping[str, float], differ: Differ) -> pd.DataFrame:
    baseline = study.networks[0].name
    rows = [
        {"network": name, "score": rounded(score)}
        | ({} if name == baseline else differ(name, baseline).columns("difference"))
        for name, score in scores.items()
    ]
    return _frame(rows, ENSEMBLES)


def _frame(rows: list[dict[str, Any]], columns: Mapping[str, str]) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=list(columns)).astype(columns)


def _verdict(study: RecordedStudy, row: Mapping[str, Any], *, is_shown: bool) -> str | None:
    """Return the word for a variant whose errors were compared; `is_shown`: its test is significant after Holm."""
    if study.seeds < fewest_seeds(study.terms.alpha):
        return None
    if is_shown and row["lead"] > 0 and row["difference_high"] < 0:
        return Verdict.better.value
    if is_shown and row["lead"] <= 0 and row["difference_low"] > 0:
        return Verdict.worse.value
    return Verdict.undecided.value
