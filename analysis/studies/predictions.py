"""The test predictions that a study keeps, read from its store and compared with its scores."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacevo.errors import RunError
from tacevo.records import Mode
from tacevo.results.study import RecordedStudy
from tacevo.storage.array_store import KIND, ArrayStore
from tacevo.storage.store import Store
from tacevo.text import listed
from tacevo.training.full import read_kept, score


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Predictions:
    """What every network of a study predicts for the t test images under each of its S seeds."""

    #: By network, in the order of the study, float32, shape (S, t, K), in the scaled units of training, or logits.
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
