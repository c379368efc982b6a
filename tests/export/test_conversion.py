"""Promise: a file of a network predicts as its training did, is no pickle, and is made where the class does no harm."""

import io
import json
import os
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from canaries import SECRET, canaries
from gate_cases import examples as shared
from gate_cases import needs_shared
from hostile_sources import ENDLESS_AFTERWARDS, FORGED_ANSWER, NO_PREDICTIONS, PATCHES, SEEDS
from onnx import helper
from refusals import refused
from training_jobs import CONTRACT, SOURCE
from waiting import eventually

from tacevo.api.trusted_network import build
from tacevo.choices import Numerics
from tacevo.data.dataset import Dataset
from tacevo.errors import RunError
from tacevo.export.conversion import ENTRIES, EQUIP, FORMS, Form, convert
from tacevo.export.inert import check_onnx, check_pt2
from tacevo.records import DataFacts, Kind, Loss
from tacevo.sandbox.client import Sandbox
from tacevo.sandbox.processes import descendants
from tacevo.training.numerics import environment
from tacevo.training.weights import Weights

SIZE, OUTPUTS = CONTRACT.image_size, CONTRACT.outputs

#: It draws a tensor that is not among its weights.
DRAWS = SOURCE.replace("super().__init__()", "super().__init__(); self.drawn = torch.randn(1)").replace(
    "return ", "return self.drawn + "
)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Make ten images, of which seven are tested."""
    path = tmp_path_factory.mktemp("data") / "images.npy"
    np.save(path, np.random.default_rng(0).integers(0, 256, (10, 3, SIZE, SIZE), dtype=np.uint8))
    names = tuple(f"F{number}" for number in range(OUTPUTS))
    rows = np.arange(10)
    return Dataset(
        facts=DataFacts(
            fingerprint="f",
            kind=CONTRACT.kind,
            counts=(2, 1, 7),
            in_channels=3,
            image_size=SIZE,
            outputs=OUTPUTS,
            names=names,
        ),
        images=path,
        targets=np.zeros((10, OUTPUTS), np.float32),
        train=rows[:2],
        validation=rows[2:3],
        test=rows[3:],
        mean=(100.0, 110.0, 120.0),
        deviation=(50.0, 60.0, 70.0),
        offset=(0.5,) * OUTPUTS,
        scale=(4.0,) * OUTPUTS,
    )


@pytest.fixture(scope="module")
def sandbox(data: Dataset) -> Iterator[Sandbox]:
    """Open the sandbox of an export, behind traps."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TACEVO_CANARY", SECRET)
        images = {"images": data.images}
        with Sandbox(entries=ENTRIES, environment=environment(Numerics.portable), arrays=images, equip=EQUIP) as opened:
            yield opened


def example(data: Dataset, source: str = SOURCE, seed: int = 1) -> tuple[Weights, Any]:
    """Draw weights; return them, and what they must predict in the units of the recording."""
    torch.manual_seed(seed)
    model = build(source, "drawn_for_a_test", CONTRACT).eval()
    images = np.load(data.images)[data.test].astype(np.float32)
    inputs = (images.transpose(0, 2, 3, 1) - data.mean) / data.deviation
    with torch.no_grad():
        outputs = model(torch.tensor(inputs.transpose(0, 3, 1, 2), dtype=torch.float32)).numpy()
    weights = {name: value.numpy() for name, value in model.state_dict().items()}
    return weights, outputs.astype(np.float64) * data.scale + data.offset


@pytest.mark.few(1)
@pytest.mark.parametrize("form", FORMS)
def test_file_is_the_mean_of_its_networks(form: Form, sandbox: Sandbox, data: Dataset) -> None:
    """For one image and for many; twice the same bytes of ONNX."""
    (one, first), (other, second) = example(data), example(data, seed=2)
    expected = (first + second) / 2
    made = convert(sandbox, form, SOURCE, contract=CONTRACT, data=data, weights=[one, other], expected=expected)
    assert made.difference < 1e-6
    assert {size: len(times) for size, times in made.milliseconds.items()} == {"1": 40, "32": 40}
    with refused(RunError, place=f"model.{form}", got="a difference of"):
        convert(sandbox, form, SOURCE, contract=CONTRACT, data=data, weights=[one, one], expected=expected)


@pytest.mark.slow
def test_file_of_classes_gives_probabilities(sandbox: Sandbox, data: Dataset) -> None:
    """The mean of those of its networks, not of their logits."""
    contract, bare = (
        replace(CONTRACT, kind=Kind.classification, loss=Loss.cross_entropy),
        replace(data, scale=(), offset=()),
    )
    (one, first), (other, second) = example(data), example(data, seed=2)
    logits = (np.array([first, second]) - data.offset) / data.scale
    powers = np.exp(20 * logits - (20 * logits).max(axis=2, keepdims=True))
    sharp = SOURCE.replace("return ", "return 20 * ")
    expected = (powers / powers.sum(axis=2, keepdims=True)).mean(axis=0)
    made = convert(sandbox, "onnx", sharp, contract=contract, data=bare, weights=[one, other], expected=expected)
    assert made.difference < 1e-5


@pytest.mark.slow
def test_largest_of_uneven_parts_are_written(sandbox: Sandbox, data: Dataset) -> None:
    """Torch's export has no operator of ONNX for them; one that is not known is named."""
    pooled = SOURCE.replace("self.body(x)", "self.body(F.interpolate(F.adaptive_max_pool2d(x, (3, 2)), (4, 4)))")
    weights, expected = example(data, pooled)
    made = convert(sandbox, "onnx", pooled, contract=CONTRACT, data=data, weights=[weights], expected=expected)
    assert made.difference < 1e-6
    other = SOURCE.replace("return ", "return x.flatten(1).kthvalue(1)[0][:, None] + ")
    with pytest.raises(RunError, match=r"aten\.kthvalue"):
        convert(sandbox, "onnx", other, contract=CONTRACT, data=data, weights=[weights], expected=expected)


def test_draws_beside_the_weights_are_refused(sandbox: Sandbox, data: Dataset) -> None:
    """What the files hold would not be what was trained."""
    weights, expected = example(data, DRAWS)
    with refused(RunError, got="a difference of"):
        convert(sandbox, "onnx", DRAWS, contract=CONTRACT, data=data, weights=[weights], expected=expected)


def test_weights_of_another_class_are_refused(sandbox: Sandbox, data: Dataset) -> None:
    """By name, type and shape."""
    weights, expected = example(data)
    name = next(iter(weights))
    for change in ({"more": weights[name]}, {name: weights[name][:1]}, {name: weights[name].astype(np.float64)}):
        with refused(RunError, place="model.onnx", got="crashed: ValueError: expected"):
            forged = {**weights, **change}
            convert(sandbox, "onnx", SOURCE, contract=CONTRACT, data=data, weights=[forged], expected=expected)


PROGRAMS = shared("hostile")


#: They have the weights of `SOURCE`, so that they are called, too; those without an end take all of the limit.
OWN = {
    **{f"patches {name}": source for name, source in PATCHES.items()},
    **{f"predicts {name}": source for name, source in NO_PREDICTIONS.items()},
    **{f"endless {name}": source for name, source in ENDLESS_AFTERWARDS.items()},
    "seeds": SEEDS,
    "forged answer": FORGED_ANSWER,
}


@pytest.fixture(scope="module")
def started(sandbox: Sandbox, data: Dataset) -> set[int]:
    """Return the processes of the sandbox once a candidate was in it."""
    weights, expected = example(data)
    for form in FORMS:
        convert(sandbox, form, SOURCE, contract=CONTRACT, data=data, weights=[weights], expected=expected)
    return set(descendants(os.getpid()))


@pytest.mark.long
@needs_shared
@pytest.mark.parametrize("program", PROGRAMS, ids=[program["id"] for program in PROGRAMS])
def test_hostile_program_gets_no_file_out(
    program: Any, sandbox: Sandbox, started: set[int], data: Dataset, place: Path
) -> None:
    """Whatever it does as it is built, no trap is sprung, and no file comes of weights that are not its own."""
    _, expected = example(data)
    with canaries() as traps:
        with pytest.raises(RunError):
            convert(sandbox, "pt2", program["source"], contract=CONTRACT, data=data, weights=[{}], expected=expected)
        assert traps.sprung() == []
    assert eventually(lambda: started.issuperset(descendants(os.getpid())))
    assert not [*place.iterdir()]


@pytest.mark.long
@pytest.mark.parametrize("name", OWN)
def test_hostile_network_writes_what_was_trained_or_nothing(
    name: str, sandbox: Sandbox, started: set[int], data: Dataset, place: Path
) -> None:
    """Called as it is written, too; a file that comes predicts as the training did, for it was tried without it."""
    weights, expected = example(data)
    with canaries() as traps:
        for form in FORMS:
            with suppress(RunError):
                source = OWN[name]
                convert(sandbox, form, source, contract=CONTRACT, data=data, weights=[weights], expected=expected)
        assert traps.sprung() == []
    assert eventually(lambda: started.issuperset(descendants(os.getpid())))
    assert not [*place.iterdir()]


WEIGHTS, CONSTANTS = "data/weights/model_weights_config.json", "data/constants/model_constants_config.json"


def archive(**members: bytes) -> bytes:
    """Make an archive as torch.export does."""
    file = io.BytesIO()
    plain = json.dumps({"config": {"a": {"use_pickle": False, "path_name": "weight_0"}}}).encode()
    with zipfile.ZipFile(file, "w") as written:
        for name, content in {WEIGHTS: plain, CONSTANTS: plain, **members}.items():
            written.writestr(name if name.startswith("/") else f"archive/{name}", content)
    return file.getvalue()


def compressed(content: bytes) -> bytes:
    """Make an archive whose weight unpacks to more than it takes."""
    file = io.BytesIO(archive())
    with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as written:
        written.writestr("archive/data/weights/weight_0", content)
    return file.getvalue()


@pytest.mark.parametrize(
    "file",
    [
        b"",
        b"PK",
        archive(**{WEIGHTS: b'{"config": {"a": {"use_pickle": true, "path_name": "weight_0"}}}'}),
        archive(**{CONSTANTS: b'{"config": {"a": {"use_pickle": false, "path_name": "opaque_obj_0"}}}'}),
        archive(**{CONSTANTS: b'{"config": {"a": {"use_pickle": false, "path_name": "custom_obj_0"}}}'}),
        archive(**{WEIGHTS: b'{"config": []}'}),
        archive(**{WEIGHTS: b"["}),
        archive(**{"data/constants/opaque_obj_0": b"\x80\x02."}),
        archive(**{"data/aotinductor/model/a.so": b"\x7fELF"}),
        archive(**{"more_config.json": b'{"config": {}}'}),
        archive(**{"/serialized_state_dict.pt": b"\x80\x02."}),
        archive(**{"data/sample_inputs/model.pt": b"\x80\x02."}),
        compressed(b"0" * 2**20),
    ],
)
def test_pickle_in_a_file_is_refused(file: bytes) -> None:
    """Torch would run it as it loads the file."""
    with pytest.raises(ValueError, match=r"expected|Expecting"):
        check_pt2(file)


def test_plain_file_is_accepted() -> None:
    """Of sample inputs, too, where there are none."""
    check_pt2(archive(**{"data/sample_inputs/model.pt": b""}))


def in_another_file(name: str) -> onnx.TensorProto:
    """Make a tensor whose values lie in another file."""
    tensor = helper.make_tensor(name, onnx.TensorProto.FLOAT, [1], [0.0])
    tensor.ClearField("float_data")
    tensor.data_location = onnx.TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="../../etc/passwd")
    return tensor


def nested(*nodes: onnx.NodeProto, initial: Sequence[onnx.TensorProto] = (), depth: int = 2) -> onnx.GraphProto:
    """Make a graph whose nodes lie below so many others, in their branches."""
    value = helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, [1])
    graph = helper.make_graph(list(nodes), "inner", [], [value], initializer=list(initial))
    for _ in range(depth):
        graph = helper.make_graph([helper.make_node("If", ["c"], ["y"], then_branch=graph)], "outer", [], [value])
    return graph


def as_function(node: onnx.NodeProto) -> onnx.ModelProto:
    """Make a model that has a node in the body of a function."""
    function = helper.make_function("own", "f", ["x"], ["y"], [node], [helper.make_opsetid("", 18)])
    model = helper.make_model(nested(helper.make_node("f", ["x"], ["y"], domain="own")))
    model.functions.append(function)
    return model


FOREIGN, RELU = (
    helper.make_node("EPContext", ["x"], ["y"], domain="com.microsoft"),
    helper.make_node("Relu", ["x"], ["y"]),
)
CONSTANT = helper.make_node("Constant", [], ["y"], value=in_another_file("w"))


@pytest.mark.parametrize(
    "model",
    [
        helper.make_model(nested(initial=[in_another_file("w")], depth=0)),
        helper.make_model(nested(initial=[in_another_file("w")])),
        helper.make_model(nested(CONSTANT)),
        helper.make_model(nested(FOREIGN)),
        as_function(CONSTANT),
        as_function(FOREIGN),
    ],
)
def test_other_files_and_foreign_operators_are_refused_wherever_they_are(model: onnx.ModelProto) -> None:
    """In branches, in attributes and in functions: whoever runs the file would read what they name."""
    with pytest.raises(ValueError, match="expected"):
        check_onnx(model.SerializeToString())


def test_notes_are_found_wherever_they_are() -> None:
    """They name directories of this machine; a model without them, with functions of its own, is accepted."""
    model = as_function(RELU)
    check_onnx(model.SerializeToString())
    model.functions[0].node[0].metadata_props.add(key="stack_trace", value="/home/me/net.py")
    with pytest.raises(ValueError, match="no notes"):
        check_onnx(model.SerializeToString())
    with pytest.raises(ValueError, match="expected an ONNX model"):
        check_onnx(b"\xff")
