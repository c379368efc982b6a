"""Promise: an operation without a deterministic form is refused on a CPU, named on a GPU, never passed in silence."""

import contextlib
import os
import warnings
from dataclasses import replace
from typing import Any

import pytest
import torch
from gpus import needs_gpu
from refusals import refused
from training_jobs import RECIPE, examples, header_of, payload_of, trained

from tacevo.choices import Confinement, Layout, Precision
from tacevo.config.compose import compose
from tacevo.config.identity import identity
from tacevo.errors import ConfigError
from tacevo.records import Gpu, written
from tacevo.runs.wiring import order_of, recipe_of
from tacevo.sandbox.devices import DEVICES
from tacevo.storage.canonical import value_at
from tacevo.training.determinism import noting_nondeterminism
from tacevo.training.gpu import equip
from tacevo.training.numerics import check_gpus

pytestmark = pytest.mark.usefixtures("torch_settings")

#: Its pooling has windows that overlap: CUDA's own backward pass adds in whatever order the threads arrive.
POOLING = """
class Net(nn.Module):
    def __init__(self, in_channels=3, num_outputs=2):
        super().__init__()
        self.conv = nn.Conv2d(in_channels, 8, 3, padding=1)
        self.head = nn.Linear(144, num_outputs)

    def forward(self, x):
        x = self.conv(x)
        pooled = F.adaptive_avg_pool2d(x, 3), F.adaptive_max_pool2d(x, 3)
        return self.head(torch.cat(pooled, 1).flatten(1))
"""
#: What has no deterministic backward pass on a GPU, and is not replaced.
SAMPLING = POOLING.replace(
    "x = self.conv(x)",
    "grid = F.affine_grid(torch.eye(2, 3).expand(len(x), 2, 3).to(x), x.shape, align_corners=False)\n"
    "        x = F.grid_sample(self.conv(x), grid, align_corners=False)",
)


def unpool() -> torch.Tensor:
    """Call what has no deterministic form on a CPU either."""
    values, places = torch.nn.functional.max_pool2d(torch.ones(1, 1, 4, 4), 2, return_indices=True)
    return torch.nn.functional.max_unpool2d(values, places, [2, 2])


def test_cpu_refuses() -> None:
    """No record is needed of what cannot happen."""
    with (
        noting_nondeterminism(torch.device("cpu")),
        pytest.raises(RuntimeError, match="does not have a deterministic implementation"),
    ):
        unpool()


def test_gpu_notes_what_it_cannot_do_deterministically() -> None:
    """By name, once however often it ran; the search takes names alone, so what torch words otherwise becomes one."""
    with noting_nondeterminism(torch.device("cuda")) as noted:
        unpool()
        unpool()
        warnings.warn("Flash (v2) defaults to a non-deterministic algorithm. " + "x" * 100, stacklevel=1)
        warnings.warn("something else", stacklevel=1)
    name = "Flash_v2_defaults_to_a_non_deterministic_algorithm._" + "x" * 100
    assert noted == {"max_unpooling2d_forward_out", name[:100]}


@pytest.mark.parametrize(
    ("overrides", "place", "expected", "got"),
    [
        ("sandbox.require=process numerics=fast training.gpu=X", "sandbox.require", "none", '"process"'),
        (
            "sandbox.require=kernel numerics=fast training.gpu=X executor=ray executor.per_gpu=1",
            "sandbox.require",
            "none",
            '"kernel"',
        ),
        ("executor=ray executor.per_gpu=null sandbox.require=none", "executor.per_gpu", "a number", "null"),
        ("sandbox.require=none numerics=portable training.gpu=X", "numerics.kind", "fast", '"portable"'),
        ("sandbox.require=none numerics=fast", "training.gpu", "the GPU's model", "null"),
    ],
)
def test_cuda_promises_no_more_than_it_keeps(overrides: str, place: str, expected: str, got: str) -> None:
    """A run on a GPU says itself that its candidates are not behind walls and its bits not portable."""
    with refused(ConfigError, place=place, expected=expected, got=got):
        compose(["training.device=cuda", *overrides.split()])


@pytest.mark.parametrize(
    ("overrides", "strongest", "doors"),
    [
        ("training.device=cuda training.gpu=X numerics=fast sandbox.require=kernel", Confinement.kernel, DEVICES),
        ("training.device=cuda training.gpu=X numerics=fast sandbox.require=none", Confinement.none, ()),
        *((f"sandbox.require={level}", Confinement.kernel, ()) for level in Confinement),
    ],
)
def test_walls_of_a_gpu_stand_where_they_are_demanded(
    overrides: str, strongest: Confinement, doors: tuple[str, ...]
) -> None:
    """With doors for its device files; without the demand there are no walls, and on a CPU no doors."""
    order = order_of(compose(overrides.split()))
    assert (order.strongest, order.doors) == (strongest, doors)


def test_gpu_is_lent_by_memory_unless_a_number_is_set() -> None:
    """It decides no result."""
    config = compose(["training.device=cuda", "training.gpu=X", "sandbox.require=kernel", "numerics=fast"])
    assert config.executor.per_gpu is None


def test_device_enters_the_identity_only_where_it_is_set() -> None:
    """Runs on a CPU stay the runs that they were; on a GPU its model is part of the run, and of each key."""
    assert not {"device", "gpu", "precision", "gpu_memory_mib"} & written(compose([]).training).keys()
    gpu = compose(["training.device=cuda", "training.gpu=NVIDIA H200", "sandbox.require=none", "numerics=fast"])
    assert value_at(identity(gpu), ("training", "device")) == "cuda"
    assert value_at(identity(gpu), ("training", "gpu")) == "NVIDIA H200"
    assert recipe_of(gpu).gpu == Gpu(model="NVIDIA H200", precision=Precision.float32, memory_mib=8192, captured=True)
    assert recipe_of(compose([])).gpu is None
    changes: list[dict[str, Any]] = [{"gpu": "X"}, {"precision": Precision.bf16}, {"gpu_memory_mib": 4096}]
    changes += [{"layout": Layout.channels_last}, {"captured": False}]
    for change in changes:
        assert identity(replace(gpu, training=replace(gpu.training, **change))) != identity(gpu)


@pytest.mark.few(1)
@pytest.mark.parametrize(("key", "value"), [("gpu", "NVIDIA H200"), ("precision", "tf32"), ("gpu_memory_mib", "4096")])
def test_settings_of_a_gpu_are_refused_on_a_cpu(key: str, value: str) -> None:
    """They would look as if they had an effect."""
    with refused(ConfigError, place=f"training.{key}", expected="with training.device=cpu", got=value):
        compose([f"training.{key}={value}"])


@pytest.mark.parametrize(
    ("model", "fits"),
    [("NVIDIA H200", True), ("NVIDIA H200 MIG 1g.18gb", True), ("NVIDIA A100", False), ("NVIDIA H20", False)],
)
def test_run_is_told_before_it_starts_that_its_gpu_is_not_here(model: str, fits: bool) -> None:
    """A part of a GPU has its name, and more words; where the driver lists none, each training finds out."""
    expected = contextlib.nullcontext() if fits else refused(ConfigError, place="training.gpu", expected="NVIDIA H200")
    with expected:
        check_gpus(model, ["NVIDIA H200", "NVIDIA H200"])
    check_gpus(model, [])


def trained_on_gpu(source: str, precision: Precision = Precision.float32) -> list[tuple[Any, bytes]]:
    """Train on a GPU in this process; return the frames."""
    data = examples()
    gpu = Gpu(model=torch.cuda.get_device_name(0), precision=precision, memory_mib=1024)
    lease = {"visible": os.environ.get("CUDA_VISIBLE_DEVICES", "0"), "per_gpu": 1}
    changes = {"device": "cuda", "recipe": written(replace(RECIPE, gpu=gpu)), "lease": lease}
    header = {**header_of(source, data), **changes}
    return trained(header, data, equip(header, payload_of(data), {"images": data.images})["images"])


@needs_gpu
@pytest.mark.parametrize("precision", Precision)
def test_gpu_repeats_what_every_baseline_does(precision: Precision, monkeypatch: pytest.MonkeyPatch) -> None:
    """Trainings with adaptive pooling give equal bits, and nothing is noted."""
    monkeypatch.setenv("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    first = trained_on_gpu(POOLING, precision)
    assert "not_deterministic" not in first[-1][0]
    for _ in range(3):
        assert trained_on_gpu(POOLING, precision) == first


@needs_gpu
def test_gpu_notes_what_has_no_deterministic_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """It trains, and its record says what it used."""
    monkeypatch.setenv("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    assert trained_on_gpu(SAMPLING)[-1][0]["not_deterministic"] == ["grid_sampler_2d_backward_cuda"]
