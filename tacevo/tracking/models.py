"""An exported network in MLflow: a run of its own with the ONNX model, and a version in the model registry.

What it promises: no pickle and no code of the network is written, and none of it is run; one export is registered once
under a name, however often it is asked for. MLflow's flavour for PyTorch rebuilds a module in this process, and its
default is a pickle, so only `model.onnx` is logged.
"""

import contextlib
import json
import re
from collections.abc import Callable, Iterator, Mapping
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mlflow
import numpy as np
import onnx
from mlflow.models import Model, ModelSignature
from mlflow.types import Schema, TensorSpec

from tacevo.errors import ConfigError
from tacevo.storage.canonical import content_hash
from tacevo.tracking.mlflow_store import PARENT_TAG, find_or_create_experiment, log, open_store, tagged_runs, user_tags
from tacevo.tracking.params import config_params, note
from tacevo.tracking.writer import NOTE_TAG, RUN_TAG

#: The tag that names an export and what it is registered as, and the one that has its version once it is.
EXPORT_TAG = "tacevo.export"

VERSION_TAG = "tacevo.version"

#: Packages that the model needs to be loaded.
_PACKAGES = ("numpy", "onnx", "onnxruntime")

#: What the model carries beside itself: names and units, and where it comes from; its card is the description.
_CARRIED = ("config.json", "run.json")

#: Above the card, whose programs find their files in the exported directory alone.
_USE = """Only the ONNX model is here:

    mlflow.pyfunc.load_model("models:/{name}/VERSION").predict(images)["outputs"]

The programs below are for the directory that `tacevo export` writes.

"""

#: A name that neither MLflow nor an address `models:/NAME/1` takes for something else.
_NAME = re.compile(r"[\w.\- ]{1,200}")


def check_registry(name: str, uri: str, experiment: str) -> None:
    """Check that a model can be registered, before hours of training; an experiment that is missing is created.

    Raises:
        ConfigError: the name is not one.
        RunError: the experiment was deleted.
        MlflowException: the store cannot be opened, or has no registry.
    """
    if not _NAME.fullmatch(name):
        expected = "letters, digits, '.', '_', '-' and spaces, at most 200"
        raise ConfigError(repr(name), place="--register", expected=expected, remedy="choose another name")
    client = open_store(uri)
    find_or_create_experiment(client, experiment)
    client.search_model_versions(f"name='{name}'", max_results=1)


def register(export: Path, name: str, *, search: str, uri: str, experiment: str, metrics: Mapping[str, float]) -> str:
    """Log the ONNX model of an export, and register it.

    The model's run is nested under that of its search, which is found by its `search_key`, where that stands in the
    experiment. The metrics are those on the test images.

    Returns:
        The model's version.

    Raises:
        RunError, MlflowException: as `check_registry`.
    """
    model = (export / "model.onnx").read_bytes()
    client = open_store(uri)
    place = find_or_create_experiment(client, experiment)
    key = content_hash([sha256(model).hexdigest(), name])
    for known in list(tagged_runs(client, place, EXPORT_TAG, key)):
        if VERSION_TAG in known.data.tags:
            return str(known.data.tags[VERSION_TAG])
        client.delete_run(known.info.run_id)  # it was left unfinished
    config, recorded = (json.loads((export / file).read_text(encoding="utf-8")) for file in ("config.json", "run.json"))
    # Without YAML, in which a name may have lines of its own: they are indented.
    card = (export / "README.md").read_text(encoding="utf-8").partition("\n---\n")[2].lstrip()
    card = note(_USE.format(name=name) + card, "README.md")
    tags = {EXPORT_TAG: key, NOTE_TAG: card, "mlflow.source.name": "tacevo export", "mlflow.source.type": "LOCAL"}
    if (parent := next(tagged_runs(client, place, RUN_TAG, search), None)) is not None:
        tags[PARENT_TAG] = parent.info.run_id
    run: str = client.create_run(place, run_name=name, tags=tags | user_tags()).info.run_id
    names = ("run", "digest", "candidate", "task", "like", "study", "recipe", "numerics")
    trainings = {name: [one[name] for one in recorded["trainings"]] for name in ("seed", "epoch")}
    params = {name: recorded[name] for name in names if recorded[name] is not None}
    described = config_params({**params, "training": trainings})
    log(client, run, described, [(*metric, 0) for metric in metrics.items()])
    logged = client.create_logged_model(place, name=recorded["candidate"], source_run_id=run, params=described)
    size, outputs = config["input"]["size"], len(config["outputs"]["names"])
    mean = np.asarray(config["input"]["mean"], np.float32)
    with _used(uri):
        made = Model.log(
            artifact_path=None,
            model_id=logged.model_id,  # one that MLflow makes itself stands in the default experiment
            run_id=run,
            flavor=mlflow.onnx,
            registered_model_name=name,
            onnx_model=onnx.load_from_string(model),
            signature=ModelSignature(
                inputs=Schema([TensorSpec(np.dtype(np.float32), (-1, len(mean), size, size))]),
                outputs=Schema([TensorSpec(np.dtype(np.float32), (-1, outputs))]),
            ),
            # The mean colour of the training images: an input as the model takes it, and nobody's image.
            input_example=np.broadcast_to(mean[:, None, None], (1, len(mean), size, size)).copy(),
            pip_requirements=[f"{package}=={version(package)}" for package in _PACKAGES],
            onnx_execution_providers=["CPUExecutionProvider"],  # what its predictions were checked with
            save_as_external_data=False,
            extra_files=[str(export / file) for file in _CARRIED],
        )
    number = str(made.registered_model_version)
    client.update_model_version(name, number, card)
    client.set_tag(run, VERSION_TAG, number)
    client.set_terminated(run, "FINISHED")
    return number


@contextlib.contextmanager
def _used(uri: str) -> Iterator[None]:
    """Let MLflow's functions without a client work on a store; leave the process as it was."""
    is_set: Callable[[], bool] = mlflow.tracking.is_tracking_uri_set
    before: Any = mlflow.get_tracking_uri() if is_set() else None
    mlflow.set_tracking_uri(uri)
    try:
        yield
    finally:
        mlflow.set_tracking_uri(before)
