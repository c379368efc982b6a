"""An exported network in MLflow predicts as its file does, is there once, and nothing of it is a pickle."""

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import onnxruntime
import pytest
from mirrored import LINES, build_run, everything, mirror_once
from onnx import TensorProto, helper, save
from refusals import refused

import tacevo
from tacevo.cli.app import main
from tacevo.errors import ConfigError, RunError
from tacevo.storage.run_directory import RunDirectory
from tacevo.tracking.writer import search_key

if TYPE_CHECKING:
    from mlflow import MlflowClient

#: MLflow warns of its own types as it is imported.
pytestmark = pytest.mark.filterwarnings("ignore:.*Any type hint is inferred:UserWarning")

Register = Callable[..., str]


@pytest.fixture
def export(tmp_path: Path) -> Path:
    """Return a directory as an export has it, of a network that gives the mean of each colour."""
    folder = tmp_path / "model"
    folder.mkdir()
    images = helper.make_tensor_value_info("images", TensorProto.FLOAT, ["batch", 3, 4, 4])
    outputs = helper.make_tensor_value_info("outputs", TensorProto.FLOAT, ["batch", 3])
    mean = helper.make_node("ReduceMean", ["images", "axes"], ["outputs"], keepdims=0)
    axes = helper.make_tensor("axes", TensorProto.INT64, [2], [2, 3])
    graph = helper.make_graph([mean], "network", [images], [outputs], [axes])
    save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10), folder / "model.onnx")
    config = {"input": {"size": 4, "mean": [80.0, 90.0, 100.0]}, "outputs": {"names": ["Fx", "Fy", "Fz"]}}
    described: dict[str, Any] = {
        "run": "run",
        "digest": "d" * 64,
        "candidate": "g00s00",
        "task": "force",
        "like": "search",
    }
    described |= {"study": None, "recipe": {"epochs": 2}, "numerics": "portable"}
    trainings = {"trainings": [{"seed": 7, "epoch": 2}]}
    (folder / "config.json").write_text(json.dumps(config))
    (folder / "run.json").write_text(json.dumps(described | trainings))
    (folder / "README.md").write_text("---\nname: 'a\n\n  ---\n\n  [b](c)'\n---\n\n# run-g00s00\n")
    return folder


@pytest.fixture
def register(export: Path, uri: str) -> Iterator[Register]:
    """Return what registers it under a name; it leaves the process as it was."""
    from tacevo.tracking.models import register

    def call(name: str = "shear", search: str = "none") -> str:
        return register(export, name, search=search, uri=uri, experiment="tacevo", metrics={"mse": 0.5})

    yield call
    assert "MLFLOW_TRACKING_URI" not in os.environ


def versions(uri: str, name: str = "shear") -> list[Any]:
    """Return the versions of a model."""
    return list(open_client(uri).search_model_versions(f"name='{name}'"))


def open_client(uri: str) -> "MlflowClient":
    """Open a store."""
    from mlflow import MlflowClient

    return MlflowClient(uri)


def test_loaded_model_predicts_as_the_file(register: Register, export: Path, uri: str) -> None:
    """By both flavours, for any number of images; the signature is that of raw images, and the example fits it."""
    import mlflow

    from tacevo.tracking.models import _used

    assert register() == "1"
    images = np.random.default_rng(0).uniform(0, 255, (5, 3, 4, 4)).astype(np.float32)
    (expected,) = onnxruntime.InferenceSession(export / "model.onnx").run(None, {"images": images})
    with _used(uri):
        loaded = mlflow.pyfunc.load_model("models:/shear/1")
        native = mlflow.onnx.load_model("models:/shear/1")
        example = loaded.metadata.load_input_example(None)
    assert np.array_equal(loaded.predict(images)["outputs"], expected)
    assert native.SerializeToString(deterministic=True) == (export / "model.onnx").read_bytes()
    assert example.shape == (1, 3, 4, 4)
    assert loaded.predict(example)["outputs"] == pytest.approx(np.array([[80.0, 90.0, 100.0]]))
    assert str(loaded.metadata.signature.inputs) == "[Tensor('float32', (-1, 3, 4, 4))]"


def test_model_is_nested_in_its_search_with_its_card_and_no_pickle(
    register: Register, uri: str, tmp_path: Path
) -> None:
    """Where the search is there; params, metrics, card and requirements come with it."""
    build_run(tmp_path / "run", LINES)
    mirror_once(tmp_path / "run", uri)
    header = json.loads((tmp_path / "run" / "ledger.jsonl").read_text().splitlines()[0])["hash"]
    register(search=search_key(header, "run", ""))
    _, status, params, tags, histories, _ = everything(uri)["run", "shear"]
    assert (status, params["candidate"], tags["tacevo.version"], histories["mse"]) == (
        "FINISHED", "g00s00", "1", [(0, 0.5)],
    )  # fmt: skip
    (version,) = versions(uri)
    assert version.description.endswith("# run-g00s00\n")
    assert "[b](c)" not in version.description  # a name, which stands in the YAML above the card
    assert "models:/shear/VERSION" in version.description
    files = {path.name: path for path in (tmp_path / "mlartifacts").rglob("models/**/*") if path.is_file()}
    assert {"model.onnx", "MLmodel", "requirements.txt", "config.json", "run.json"} <= files.keys()
    assert "onnxruntime==" in files["requirements.txt"].read_text()
    assert not [name for name in files if name.endswith((".pkl", ".pth", ".pt", ".bin"))]
    assert not [name for name, path in files.items() if path.read_bytes().startswith(b"\x80")]
    mirror_once(tmp_path / "run", uri)
    assert "tacevo.version" in everything(uri)["run", "shear"][3]


def test_export_is_registered_once_under_a_name(register: Register, uri: str) -> None:
    """Asked again, it is the same version; what a kill left is replaced; another name is another model."""
    register()
    assert (register(), register("other")) == ("1", "1")
    client = open_client(uri)
    (run,) = (one for one in client.search_runs(["1"]) if one.info.run_name == "shear")
    client.delete_tag(run.info.run_id, "tacevo.version")
    assert register() == "2"
    assert [one.info.run_name for one in client.search_runs(["1"])].count("shear") == 1


@pytest.mark.parametrize("name", ["", "a/b", "a:1", "a'b", "a" * 201])
def test_name_that_an_address_would_misread_is_refused(name: str, uri: str) -> None:
    """Before anything is trained."""
    from tacevo.tracking.models import check_registry

    with refused(ConfigError, place="--register"):
        check_registry(name, uri, "tacevo")


def test_broken_registry_is_told_before_anything_is_trained(published: Path, place: Path) -> None:
    """And an untracked run without an address is the user's to decide."""
    run = tacevo.open(published / "run")
    assert isinstance(run, tacevo.Run)
    name = str(run.elites["id"].iloc[0])
    with refused(RunError, place="the model shear into sqlite:////proc/nowhere/x.db"):
        run.export(name, "model", register="shear", uri="sqlite:////proc/nowhere/x.db", quiet=True)
    assert RunDirectory(run.path).read_run().config["tracking"]["kind"] == "none"  # type: ignore[index,call-overload]
    with refused(ConfigError, place="tracking.uri"):
        run.export(name, "model", register="shear", quiet=True)
    with refused(ConfigError, place="--uri"):
        run.export(name, "model", register="shear", uri="postgresql://user:s3cret@host/db", quiet=True)
    assert not [*place.iterdir()]


@pytest.mark.slow
def test_command_registers_what_it_exports(published: Path, place: Path, uri: str) -> None:
    """Trained, written, registered; the model predicts what the study recorded, as the file does."""
    import mlflow

    from tacevo.tracking.models import _used

    name = str(tacevo.open(published / "run").studies[0].networks["id"].iloc[1])  # type: ignore[union-attr]
    command = ["export", str(published / "run"), name, "-o", "model", "--register", "shear", "--uri", uri]
    assert main(command) == 0
    images = np.random.default_rng(0).uniform(0, 255, (3, 3, 32, 32)).astype(np.float32)
    (expected,) = onnxruntime.InferenceSession(place / "model" / "model.onnx").run(None, {"images": images})
    with _used(uri):
        loaded = mlflow.pyfunc.load_model("models:/shear/1")
    assert np.array_equal(loaded.predict(images)["outputs"], expected)
    (version,) = versions(uri)
    assert "Fx (N)" in version.description
