"""The texts in the files of an exported network: its outputs, its metrics, and what config.json and others hold."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from statistics import quantiles

import numpy as np
from numpy.typing import NDArray

from tacevo.choices import Numerics
from tacevo.data.dataset import Dataset
from tacevo.data.labels import units_of
from tacevo.environment import checked_out, machine, versions
from tacevo.evolution.lines import CandidateLine
from tacevo.export.conversion import BOUND, Built, Converted
from tacevo.export.onnx_file import INPUT, OPSET, OUTPUT
from tacevo.export.trainings import ExportSettings, Trained, TrainingPlan
from tacevo.parts.source import Catalogue
from tacevo.randomness import stream
from tacevo.records import Contract, Json, Kind, to_json, written
from tacevo.results.run import RecordedRun
from tacevo.runs.wiring import recipe_of
from tacevo.text import printable
from tacevo.training.full import score
from tacevo.training.weights import Weights, weights_digest

#: The packages of `tacevo[export]`.
PACKAGES = ("onnx", "onnxruntime", "onnxscript", "safetensors")

#: Resamples of the test images for an interval, and the level of it.
_RESAMPLES, _LEVEL = 1000, 0.95


@dataclass(frozen=True, kw_only=True, eq=False)
class Exported:
    """A network on its way out."""

    run: RecordedRun
    line: CandidateLine
    plan: TrainingPlan
    data: Dataset
    #: The trained network, or those of an ensemble.
    trained: Sequence[Trained]
    #: The reasons why equal bits were not promised.
    doubts: tuple[str, ...]
    settings: ExportSettings
    #: The catalogue of the data, as their source gives it.
    catalogue: Catalogue
    #: Digest of its bundle, if it is in one.
    bundle: str | None
    #: The class as it was tried; None as long as it was not.
    built: Built | None = None
    #: The ONNX file; None where ONNX cannot hold the model, or as long as it was not tried.
    onnx: Converted | None = None
    #: The reason why there is no ONNX file; empty where there is one.
    without_onnx: str = ""

    @property
    def contract(self) -> Contract:
        """The contract that the class keeps."""
        return self.run.record.task.contract

    @property
    def numerics(self) -> Numerics:
        """The numerics of its training."""
        return self.plan.config.numerics.kind

    @property
    def is_regression(self) -> bool:
        """Whether its outputs are values, and not classes."""
        return self.contract.kind is Kind.regression

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of each output, empty where it is not known; () for classification."""
        return units_of(self.catalogue) if self.is_regression else ()

    @property
    def weights(self) -> list[Weights]:
        """The weights of each network."""
        return [one.weighed.weights for one in self.trained]

    @property
    def weight_files(self) -> list[str]:
        """The names of the files that hold the weights."""
        count = len(self.trained)
        return (
            ["weights.safetensors"] if count == 1 else [f"weights-{number + 1}.safetensors" for number in range(count)]
        )

    @cached_property
    def outputs(self) -> NDArray[np.float64]:
        """The whole model's outputs for the test images: units of the recording, or probabilities; shape (t, K)."""
        each = np.array([one.weighed.predictions for one in self.trained], np.float64)
        if self.is_regression:
            return np.asarray((each * self.data.scale + self.data.offset).mean(axis=0))
        powers = np.exp(each - each.max(axis=2, keepdims=True))
        return np.asarray((powers / powers.sum(axis=2, keepdims=True)).mean(axis=0))

    @cached_property
    def metrics(self) -> Mapping[str, tuple[float, float, float]]:
        """Test metrics by name: the value, and an interval over resampled test images, or groups of them if known."""
        predictions, labels = self._predictions(), self.data.targets[self.data.test]
        group_of, draws = np.array(self.data.facts.groups), stream(0, "export")
        members = [np.flatnonzero(group_of == group) for group in range(max(self.data.facts.groups, default=-1) + 1)]
        count = len(members) or len(labels)
        value = self._score(predictions, labels)
        units = (draws.integers(count, size=count) for _ in range(_RESAMPLES))
        rows = (np.concatenate([members[group] for group in each]) for each in units) if members else units
        drawn = [self._score(predictions[row], labels[row]) for row in rows]
        tail = (1 - _LEVEL) / 2
        ends = {name: np.quantile([one[name] for one in drawn], [tail, 1 - tail]) for name in value}
        return {name: (value[name], float(low), float(high)) for name, (low, high) in ends.items()}

    def _predictions(self) -> NDArray[np.float32]:
        """Return predictions as metrics take them: scaled units, or logits."""
        if len(self.trained) == 1:
            return self.trained[0].weighed.predictions
        if self.is_regression:
            return np.asarray((self.outputs - self.data.offset) / self.data.scale, np.float32)
        return np.log(np.maximum(self.outputs, 1e-30)).astype(np.float32)

    def _score(self, predictions: NDArray[np.float32], labels: NDArray[np.generic]) -> dict[str, float]:
        facts = self.data.facts
        return score(facts.kind, predictions, labels, names=facts.names, scale=self.data.scale)[0]


def config_of(model: Exported) -> dict[str, Json]:
    """Return all that a program needs to use the files, and to make their input as `tacevo.data` does."""
    data, contract, built, onnx = model.data, model.contract, model.built, model.onnx
    assert built is not None  # it was tried
    catalogue, white = model.catalogue, model.plan.config.data.white_point
    arguments = {name: contract.offered[name] for name in built.arguments}
    outputs: dict[str, Json] = {"kind": contract.kind.value, "names": [*map(printable, data.facts.names)]}
    if model.is_regression:
        outputs |= {"units": [*map(printable, model.units)], "scale": list(data.scale), "offset": list(data.offset)}
    differences = {"class": built.difference} | ({} if onnx is None else {"onnx": onnx.difference})
    return {
        "class": contract.class_name,
        "arguments": arguments,
        "weights": model.weight_files,
        "weights_sha256": [weights_digest(weights) for weights in model.weights],
        "input": {
            "layout": "NCHW",
            "channels": "RGB",
            "size": contract.image_size,
            "range": [0, 255],
            "resize": "bilinear",
            "recorded_size": None if catalogue.recorded_size is None else list(catalogue.recorded_size),
            "bits": sorted(set(catalogue.depths)),
            "white_point": white,
            "mean": list(data.mean),
            "deviation": list(data.deviation),
        },
        "outputs": outputs,
        "onnx": None if onnx is None else {"opset": OPSET, "input": INPUT, "output": OUTPUT},
        "largest_difference": differences,
        "largest_difference_allowed": BOUND,
        "contract": to_json(contract),
    }


def latency_of(model: Exported, onnx: Converted) -> dict[str, Json]:
    """Return how long a pass of the ONNX file takes on this machine, with one thread."""
    return {
        "machine": machine(),
        "versions": {"onnxruntime": version("onnxruntime")},
        "threads": 1,
        "numerics": model.numerics.value,
        "milliseconds": {"onnxruntime": {size: spread_of(passes) for size, passes in onnx.milliseconds.items()}},
    }


def spread_of(values: Sequence[float]) -> dict[str, Json]:
    """Return the quartiles of many values, and how many they are."""
    low, median, high = quantiles(values, n=4, method="inclusive")
    return {"median": median, "lower_quartile": low, "upper_quartile": high, "count": len(values)}


def run_of(model: Exported) -> dict[str, Json]:
    """Return what names the run, the candidate and its trainings."""
    run, plan, study = model.run, model.plan, model.plan.study
    trainings: list[Json] = [
        {
            "seed": one.seed,
            "epoch": one.epoch,
            "key": one.key,
            "weights_sha256_after_last_epoch": one.weighed.training.weights_sha256,
            "was_recorded": one.was_recorded,
            # Where there is no record, with the training beside it.
            "differs_from_record": to_json(one.differing) if one.was_recorded else None,
            "differs_from_other_training": None if one.was_recorded else to_json(one.differing),
        }
        for one in model.trained
    ]
    code = checked_out()
    return {
        "schema": 1,
        "run": run.name,
        "digest": run.digest,
        "bundle": model.bundle,
        "candidate": model.line.id,
        "source_sha256": model.line.source,
        "task": run.task,
        "seed": run.config.seed,
        "rules": to_json(run.rules),
        "data": to_json(run.record.data),
        "like": plan.like.value,
        "study": None if study is None else study.record.digest,
        "recipe": written(recipe_of(plan.config)),
        "numerics": model.numerics.value,
        "trainings": trainings,
        "not_promised": list(model.doubts),
        "made_by": {
            "versions": versions(*PACKAGES),
            "code": None if code is None else to_json(code),
            "machine": machine(),
        },
    }
