"""Promise: an operation without a deterministic form is refused on a CPU, named on a GPU, never passed in silence."""

import hashlib
import warnings
from collections.abc import Iterator
from typing import Any

import pytest
import torch
from training_jobs import examples, header_of, payload_of

from tacevo.config.compose import compose
from tacevo.config.identity import identity
from tacevo.errors import ConfigError
from tacevo.records import written
from tacevo.storage.canonical import value_at
from tacevo.training.determinism import note_warnings, noting_nondeterminism
from tacevo.training.trainer import run

CPU = torch.device("cpu")

#: Adaptive pooling has no deterministic backward pass on a GPU; the rest of it has.
POOLING = """
class Net(nn.Module):
    def __init__(self, in_channels=3, num_outputs=2):
        super().__init__()
        self.conv = nn.Conv2d(in_channels, 8, 3, padding=1)
        self.head = nn.Linear(32, num_outputs)

    def forward(self, x):
        return self.head(F.adaptive_avg_pool2d(self.conv(x), 2).flatten(1))
"""
PLAIN = POOLING.replace("F.adaptive_avg_pool2d(self.conv(x), 2)", "F.avg_pool2d(self.conv(x), 2)")


@pytest.fixture(autouse=True)
def _torch_settings() -> Iterator[None]:
    """Undo what a training sets for the whole process, because here it does not end with it."""
    before = torch.get_deterministic_debug_mode()
    with torch.random.fork_rng(devices=[]):
        yield
    torch.set_deterministic_debug_mode(before)


def unpool() -> torch.Tensor:
    """Call what has no deterministic form on a CPU either."""
    values, places = torch.nn.functional.max_pool2d(torch.ones(1, 1, 4, 4), 2, return_indices=True)
    return torch.nn.functional.max_unpool2d(values, places, [2, 2])


def test_cpu_refuses() -> None:
    """No record is needed of what cannot happen."""
    with noting_nondeterminism(CPU), pytest.raises(RuntimeError, match="does not have a deterministic implementation"):
        unpool()


def test_what_torch_warns_of_is_noted_by_name_once() -> None:
    """As a GPU does it: the operation runs, and its name is kept however often it ran."""
    noted: set[str] = set()
    torch.set_deterministic_debug_mode("warn")
    with warnings.catch_warnings():
        note_warnings(noted)
        unpool()
        unpool()
        warnings.warn("something else", stacklevel=1)
    assert noted == {"max_unpooling2d_forward_out"}


def test_warning_without_a_name_becomes_one() -> None:
    """Torch words some warnings otherwise; the search takes names alone, so what it says is written as one."""
    noted = set[str]()
    with warnings.catch_warnings():
        note_warnings(noted)
        warnings.warn("Flash (v2) defaults to a non-deterministic algorithm. " + "x" * 100, stacklevel=1)
    (name,) = noted
    assert name.startswith("Flash_v2_defaults_to_a_non_deterministic_algorithm._xxx")
    assert len(name) == 100


@pytest.mark.parametrize(
    ("overrides", "key"),
    [
        (
            ["sandbox.require=process", "numerics=fast"],
            'sandbox.require: expected none with training.device=cuda.*; got "process"$',
        ),
        (
            ["sandbox.require=none", "numerics=portable"],
            'numerics.kind: expected fast with training.device=cuda.*; got "portable"$',
        ),
    ],
)
def test_cuda_promises_no_more_than_it_keeps(overrides: list[str], key: str) -> None:
    """A run on a GPU says itself that its candidates are not behind walls and its bits not portable."""
    with pytest.raises(ConfigError, match=key):
        compose(["training.device=cuda", *overrides])


def test_device_enters_the_identity_only_where_it_is_set() -> None:
    """Runs on a CPU stay the runs that they were."""
    assert "device" not in written(compose([]).training)
    gpu = compose(["training.device=cuda", "sandbox.require=none", "numerics=fast"])
    assert value_at(identity(gpu), ("training", "device")) == "cuda"


def trained_on_gpu(source: str) -> list[tuple[Any, str]]:
    """Train on a GPU in this process; give each frame with the hash of its bytes."""
    data = examples()
    frames: list[tuple[Any, str]] = []
    header = {**header_of(source, data), "device": "cuda"}

    def keep(head: Any, payload: bytes) -> None:
        frames.append((head, hashlib.sha256(payload).hexdigest()))

    run(header, payload_of(data), {"images": data.images}, keep)
    return frames


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_gpu_repeats_what_has_a_deterministic_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two trainings give equal bits, and nothing is noted."""
    monkeypatch.setenv("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    first = trained_on_gpu(PLAIN)
    assert "not_deterministic" not in first[-1][0]
    assert trained_on_gpu(PLAIN) == first


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_gpu_notes_what_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """A baseline's adaptive pooling trains, and its record says what it used."""
    monkeypatch.setenv("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    assert trained_on_gpu(POOLING)[-1][0]["not_deterministic"] == ["adaptive_avg_pool2d_backward_cuda"]
