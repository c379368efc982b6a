"""Studies with test predictions, made by hand."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from studies import study_of

from analysis.studies.image_findings import Predictions
from tacevo.records import Kind
from tacevo.results.study import PRIMARY, RecordedStudy
from tacevo.storage.array_store import ArrayStore, digest_of
from tacevo.storage.store import Store
from tacevo.training.full import StoredPredictions, score

#: Predictions of each network, by name, float32, shape (S, t, K).
Networks = Mapping[str, NDArray[np.float32]]


def study_with(labels: NDArray[Any], networks: Networks) -> tuple[RecordedStudy, Predictions]:
    """Make a study whose scores are those of its predictions: float32 labels are regressed, and int64 are classes."""
    kind = Kind.regression if labels.dtype == np.float32 else Kind.classification
    outputs = next(iter(networks.values())).shape[2]
    names = ("Fx", "Fy", "Fz", "Fw")[:outputs]
    scores = {
        (name, seed): score(kind, one, labels, names=names, scale=[1.0] * outputs)
        for name, each in networks.items()
        for seed, one in enumerate(each)
    }
    study = study_of({name: [0.5] * len(each) for name, each in networks.items()}, kind=kind)
    rows = []
    for row in study.scores:
        metrics, confusion = scores[row.network, row.seed]
        kept = StoredPredictions(predictions=digest_of(networks[row.network][row.seed]), labels=digest_of(labels))
        rows.append(replace(row, metrics=metrics, confusion=confusion, kept=kept))
        assert PRIMARY[kind] in metrics
    units = ("N",) * outputs if kind is Kind.regression else ()
    data = replace(study.data, names=names, outputs=outputs, counts=(8, 1, len(labels)))
    return replace(study, data=data, units=units, scores=tuple(rows)), Predictions(of=networks, labels=labels)


def keep(predictions: Predictions, root: Path) -> None:
    """Keep predictions and labels in the store below a directory."""
    arrays = ArrayStore(Store(root, "arrays"))
    arrays.keep(predictions.labels)
    for each in predictions.of.values():
        for one in each:
            arrays.keep(one)


def forces(images: int = 40, seeds: int = 5) -> tuple[RecordedStudy, Predictions]:
    """Make a regression of two outputs: variant 1 errs less than the baseline on Fx, and variant 2 is its equal."""
    rng = np.random.default_rng(0)
    labels = rng.normal(size=(images, 2)).astype(np.float32)
    sizes = {"baseline": (1.0, 1.0), "variant 1": (0.3, 1.0), "variant 2": (1.0, 1.0)}
    shared = 0.5 * rng.normal(size=(images, 2))
    networks = {
        name: (labels + (shared + 0.5 * rng.normal(size=(seeds, images, 2))) * size).astype(np.float32)
        for name, size in sizes.items()
    }
    return study_with(labels, networks)


def gratings(images: int = 60, seeds: int = 5) -> tuple[RecordedStudy, Predictions]:
    """Make a classification of three classes: variant 1 is right more often than the baseline."""
    rng = np.random.default_rng(0)
    labels = rng.integers(3, size=images)
    truth = np.eye(3)[labels]
    networks = {
        name: (able * truth + 1.5 * rng.normal(size=(images, 3)) + 0.5 * rng.normal(size=(seeds, images, 3))).astype(
            np.float32
        )
        for name, able in {"baseline": 1.0, "variant 1": 6.0}.items()
    }
    return study_with(labels, networks)
