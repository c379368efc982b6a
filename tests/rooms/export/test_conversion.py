"""Promise: what is exported predicts as its training did, and is made where the class does no harm."""

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from canaries import SECRET, canaries
from gate_cases import examples as shared
from gate_cases import needs_shared
from hostile_sources import ENDLESS_AFTERWARDS, FORGED_ANSWER, NO_PREDICTIONS, PATCHES, SEEDS
from refusals import refused
from training_jobs import CONTRACT, SOURCE
from waiting import eventually

from tacevo.api.trusted_network import build
from tacevo.choices import Numerics
from tacevo.data.dataset import Dataset
from tacevo.errors import RunError
from tacevo.export.conversion import ENTRIES, EQUIP, Networks, check_class, convert
from tacevo.records import Contract, DataFacts, Kind, Loss
from tacevo.sandbox.client import Finished, Frame, Sandbox
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


def networks(
    data: Dataset, weights: Any, expected: Any, source: str = SOURCE, contract: Contract = CONTRACT
) -> Networks:
    """Return networks as they are converted."""
    return Networks(source=source, contract=contract, data=data, weights=weights, expected=expected)


def test_class_and_file_are_the_mean_of_their_networks(sandbox: Sandbox, data: Dataset) -> None:
    """For one image and for many; other weights are found in both, and the same ones give the same bytes."""
    (one, first), (other, second) = example(data), example(data, seed=2)
    whole = networks(data, [one, other], (first + second) / 2)
    assert check_class(sandbox.run, whole).difference < 1e-6
    made = convert(sandbox.run, whole)
    assert made.difference < 1e-6
    assert {size: len(times) for size, times in made.milliseconds.items()} == {"1": 40, "32": 40}
    wrong = replace(whole, weights=[one, one])
    with refused(RunError, place="model.py with its weights", got="a difference of"):
        check_class(sandbox.run, wrong)
    with refused(RunError, place="model.onnx", got="a difference of"):
        convert(sandbox.run, wrong)
    assert convert(sandbox.run, whole).file == made.file


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
    whole = networks(bare, [one, other], expected, sharp, contract)
    assert check_class(sandbox.run, whole).difference < 1e-5
    assert convert(sandbox.run, whole).difference < 1e-5


@pytest.mark.slow
def test_largest_of_uneven_parts_are_written(sandbox: Sandbox, data: Dataset) -> None:
    """Torch's export has no operator of ONNX for them; one that is not known is named, and its class is sound."""
    pooled = SOURCE.replace("self.body(x)", "self.body(F.interpolate(F.adaptive_max_pool2d(x, (3, 2)), (4, 4)))")
    weights, expected = example(data, pooled)
    assert convert(sandbox.run, networks(data, [weights], expected, pooled)).difference < 1e-6
    other = SOURCE.replace("return ", "return x.flatten(1).kthvalue(1)[0][:, None] + ")
    weights, expected = example(data, other)
    lacking = networks(data, [weights], expected, other)
    assert check_class(sandbox.run, lacking).difference < 1e-6
    with pytest.raises(RunError, match=r"aten\.kthvalue"):
        convert(sandbox.run, lacking)


def test_draws_beside_the_weights_are_refused(sandbox: Sandbox, data: Dataset) -> None:
    """What the files hold would not be what was trained."""
    weights, expected = example(data, DRAWS)
    with refused(RunError, got="a difference of"):
        check_class(sandbox.run, networks(data, [weights], expected, DRAWS))


def test_weights_of_another_class_are_refused(sandbox: Sandbox, data: Dataset) -> None:
    """By name, type and shape."""
    weights, expected = example(data)
    name = next(iter(weights))
    for change in ({"more": weights[name]}, {name: weights[name][:1]}, {name: weights[name].astype(np.float64)}):
        with refused(RunError, place="model.py with its weights", got="crashed: ValueError: expected"):
            check_class(sandbox.run, networks(data, [{**weights, **change}], expected))


#: It stands before a class, and changes what torch gives to whoever writes ONNX: notes everywhere, or a function.
MEDDLING = """
class Kept:
    def __init__(self, model):
        self.model_proto = model
real = torch.onnx.export
def export(*given, **named):
    model = real(*given, **named).model_proto
    {change}
    return Kept(model)
torch.onnx.export = export
"""

#: What a program puts there.
TEXT = "__import__('os').system('id')"


@pytest.mark.slow
def test_program_of_a_candidate_leaves_no_text_in_the_file(sandbox: Sandbox, data: Dataset) -> None:
    """It reaches the process that converts, whatever doors the gate has: what it adds is left out, or refused."""
    weights, expected = example(data)
    notes = f"model.doc_string = model.producer_name = model.graph.node[0].name = {TEXT!r}"
    source = MEDDLING.format(change=notes) + SOURCE
    assert TEXT.encode() not in convert(sandbox.run, networks(data, [weights], expected, source)).file
    for change in (f"model.graph.node[0].domain = {TEXT!r}", f"model.graph.initializer[0].name = {TEXT!r}"):
        source = MEDDLING.format(change=change) + SOURCE
        with refused(RunError, place="model.onnx"):
            convert(sandbox.run, networks(data, [weights], expected, source))


@pytest.mark.parametrize("answer", [b"", b"PK\x03\x04", b"\x80\x04c__builtin__\neval\n.", TEXT.encode()])
def test_what_is_no_network_is_no_file(answer: bytes, data: Dataset) -> None:
    """Whatever the process that converts sends, it is not even checked, and the error names the file."""
    asked: list[str] = []

    def run(entry: str, header: Any, payload: bytes, limits: Any, score: Any = None, /) -> Finished:
        asked.append(entry)
        return Finished((Frame({}, answer),))

    with refused(RunError, place="model.onnx", expected="what a network sends"):
        convert(run, networks(data, [{}], np.zeros((7, OUTPUTS))))
    assert asked == ["convert"]


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
    convert(sandbox.run, networks(data, [weights], expected))
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
        for act in (check_class, convert):
            with pytest.raises(RunError):
                act(sandbox.run, networks(data, [{}], expected, program["source"]))
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
        for act in (check_class, convert):
            with suppress(RunError):
                act(sandbox.run, networks(data, [weights], expected, OWN[name]))
        assert traps.sprung() == []
    assert eventually(lambda: started.issuperset(descendants(os.getpid())))
    assert not [*place.iterdir()]
