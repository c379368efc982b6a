"""Promise: a step that is recorded once and replayed trains as one that runs each time, or is not recorded.

Most of it needs no GPU: what stands for a graph records the kernels of a step, and runs them again in the memory that
they had, without any Python of the candidate. `make test-gpu` runs the rest, by CUDA's graphs.
"""

import os
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from gpus import needs_gpu
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves
from training_jobs import RECIPE, SOURCE, Data, examples, header_of, payload_of

from tacevo.choices import Layout, Precision
from tacevo.records import Gpu, Reason, written
from tacevo.training.gpu import Resident, equip
from tacevo.training.trainer import run

DATA = examples()
GPU = Gpu(model="NVIDIA H200", precision=Precision.float32, memory_mib=4096, captured=True)

#: Without a dropout, whose numbers a recorded step draws in another order.
PLAIN = SOURCE.replace("nn.Dropout(0.1)", "nn.BatchNorm1d(32)")

BODY = "return self.head(self.body(x))"

#: A count that is changed in place, in the memory that a recorded step has.
IN_PLACE = PLAIN.replace(
    "super().__init__()", "super().__init__()\n        self.register_buffer('n', torch.ones(()))"
).replace(BODY, "if self.training:\n            self.n += 1\n        return self.head(self.body(x)) / self.n")

pytestmark = pytest.mark.usefixtures("torch_settings")


class Kernels(TorchDispatchMode):
    """Notes the kernels that run within, and what the memory held that they were given."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self._calls: list[tuple[Any, Any, Any, list[torch.Tensor], set[int]]] = []
        #: By address: memory that was there before, and what it held.
        self._before: dict[int, tuple[Any, Any]] = {}
        self._own: set[int] = set()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        given = {memory._cdata: memory for memory in map(torch.Tensor.untyped_storage, _tensors((args, kwargs)))}
        for place, memory in given.items():
            if place not in self._own:
                self._before.setdefault(place, (memory, _copied(memory)))
        output = func(*args, **kwargs)
        self._own |= {tensor.untyped_storage()._cdata for tensor in _tensors(output)} - self._before.keys()
        self._calls.append((func, args, kwargs, _tensors(output), set(given)))
        return output

    def undo(self) -> None:
        """Give the memory that was there before what it held."""
        for memory, held in self._before.values():
            memory.copy_(held)

    def replay(self) -> None:
        """Run the kernels again; what they make goes where it went."""
        with torch.no_grad():
            for func, args, kwargs, outputs, given in self._calls:
                for place, made in zip(outputs, _tensors(func(*args, **kwargs)), strict=True):
                    if place.untyped_storage()._cdata not in given:
                        place.detach().copy_(made)


def _copied(memory: Any) -> Any:
    return memory.clone()


def _tensors(value: Any) -> list[torch.Tensor]:
    return [leaf for leaf in tree_leaves(value) if isinstance(leaf, torch.Tensor)]


class Graphs:
    """Records steps, and counts how often each was replayed."""

    def __init__(self, error: Exception | None = None) -> None:
        self.recorded = self.replayed = 0
        self._error = error

    def capture(self, step: Callable[[], None]) -> Callable[[], None]:
        """Return what runs the step's kernels; recording leaves nothing behind."""
        self.recorded += 1
        if self._error is not None:
            raise self._error
        kernels = Kernels()
        with kernels:
            step()
        kernels.undo()

        def replay() -> None:
            self.replayed += 1
            kernels.replay()

        return replay


def train(source: str, graphs: Graphs | None, data: Data = DATA, **changes: Any) -> list[tuple[Any, bytes]]:
    """Train a candidate whose steps are recorded, or with None one whose steps are not; return the frames."""
    header = {**header_of(source, data), "recipe": written(replace(RECIPE, gpu=GPU, **changes)), "contiguous": True}
    rows = np.frombuffer(payload_of(data), np.int64, len(data.train) + len(data.validation))
    images = Resident(data.images, rows, torch.device("cpu"))
    arrays = {"images": images, **({} if graphs is None else {"capture": graphs.capture})}
    frames: list[tuple[Any, bytes]] = []
    run(header, payload_of(data), arrays, lambda head, payload: frames.append((head, payload)))
    return frames


@pytest.mark.parametrize("source", [PLAIN, IN_PLACE], ids=["plain", "count in place"])
def test_recorded_steps_train_as_others_do(source: str) -> None:
    """Losses, statistics of normalisations and weights have equal bits; predictions differ by their larger batches."""
    graphs = Graphs()
    recorded, plain = train(source, graphs), train(source, None)
    assert recorded[-1][0] == {**plain[-1][0], "captured": True}
    assert [head for head, _ in recorded[:-1]] == [head for head, _ in plain[:-1]]
    for (_, got), (_, expected) in zip(recorded[:-1], plain[:-1], strict=True):
        np.testing.assert_allclose(np.frombuffer(got, np.float32), np.frombuffer(expected, np.float32), rtol=1e-5)
    assert (graphs.recorded, graphs.replayed) == (1, RECIPE.epochs * (len(DATA.train) // RECIPE.batch_size))


def test_dropout_of_recorded_steps_follows_the_seed() -> None:
    """The numbers are drawn from a stream of its own; twice the same."""
    first, second = train(SOURCE, Graphs()), train(SOURCE, Graphs())
    assert first == second
    assert first[-1][0]["captured"]
    assert first[-1][0]["weights_sha256"] != train(SOURCE, None)[-1][0]["weights_sha256"]


#: What a network keeps from step to step by Python alone, or in another tensor each time; then what it returns.
KEPT = {
    "count of calls": ("self.kept = getattr(self, 'kept', 0) + 1", "/ self.kept"),
    "list that grows": ("self.kept = [*getattr(self, 'kept', []), 1]", "/ len(self.kept)"),
    "list of tensors": ("self.kept = [*getattr(self, 'kept', []), x.detach()]", "/ len(self.kept)"),
    "tensor made anew": ("self.kept = getattr(self, 'kept', torch.zeros(())) + 1", "/ self.kept"),
    "average made anew": ("self.kept = 0.9 * getattr(self, 'kept', 1) + 0.1 * x.detach().mean()", "/ (2 + self.kept)"),
    "count of the class": ("Net.kept = getattr(Net, 'kept', 0) + 1", "/ Net.kept"),
}
EAGER = {name: f"{first}\n        {BODY} {last}" for name, (first, last) in KEPT.items()}


@pytest.mark.parametrize("body", EAGER.values(), ids=EAGER)
def test_network_whose_steps_differ_is_not_recorded(body: str) -> None:
    """It trains step by step as if nothing had been tried, and its record says so."""
    graphs, source = Graphs(), PLAIN.replace(BODY, body)
    eager, plain = train(source, graphs), train(source, None)
    assert graphs.recorded == 0
    assert eager[-1][0] == {**plain[-1][0], "captured": False}
    assert [head for head, _ in eager[:-1]] == [head for head, _ in plain[:-1]]


def test_network_that_cannot_be_recorded_trains_all_the_same() -> None:
    """As where its step waits for the device, or needs more memory; no count or statistic is left of the attempt."""
    graphs = Graphs(RuntimeError("operation not permitted when stream is capturing"))
    eager, plain = train(SOURCE, graphs), train(SOURCE, None)
    assert (graphs.recorded, graphs.replayed) == (1, 0)
    assert eager[-1][0] == {**plain[-1][0], "captured": False}


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("return self.head(self.body(x)) * 1e30", Reason.not_finite),
        ("return self.head(self.body(x))[:, :1]", Reason.bad_output),
        ("raise ValueError('no')", Reason.forward_failed),
        ("return self.head(self.body(x)).detach()", Reason.backward_failed),
    ],
)
def test_network_that_fails_is_judged_as_without_recording(body: str, reason: Reason) -> None:
    """For the same reason."""
    source = PLAIN.replace(BODY, body)
    ends = [train(source, graphs)[-1][0]["rejection"]["reason"] for graphs in (Graphs(), None)]
    assert ends == [reason.value] * 2


def test_loss_that_is_not_finite_is_told_with_its_step() -> None:
    """The losses are read when the epoch has ended, and the first of them is named."""
    targets = DATA.targets.copy()
    targets[DATA.train[40]] = np.inf
    (*_, (end, _)) = train(PLAIN, Graphs(), replace(DATA, targets=targets))
    assert end["rejection"]["reason"] == Reason.not_finite.value
    assert "got inf in step" in end["rejection"]["detail"]


def train_on_gpu(source: str, monkeypatch: pytest.MonkeyPatch, **changes: Any) -> list[tuple[Any, bytes]]:
    """Train on the first GPU in this process; return the frames."""
    monkeypatch.setenv("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    gpu = replace(GPU, model=torch.cuda.get_device_name(0), **changes)
    lease = {"visible": os.environ.get("CUDA_VISIBLE_DEVICES", "0"), "per_gpu": 1}
    recipe = written(replace(RECIPE, gpu=gpu))
    header = {**header_of(source, DATA), "device": "cuda", "recipe": recipe, "lease": lease}
    frames: list[tuple[Any, bytes]] = []
    arrays = equip(header, payload_of(DATA), {"images": DATA.images})
    run(header, payload_of(DATA), arrays, lambda head, payload: frames.append((head, payload)))
    return frames


@needs_gpu
@pytest.mark.parametrize("layout", Layout)
@pytest.mark.parametrize("precision", Precision)
def test_gpu_records_and_repeats(precision: Precision, layout: Layout, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a dropout the weights are those of the eager loop; with one they are the same each time."""
    setting = {"precision": precision, "layout": layout}
    recorded = train_on_gpu(PLAIN, monkeypatch, **setting)
    eager = train_on_gpu(PLAIN, monkeypatch, **setting, captured=False)
    assert recorded[-1][0] == {**eager[-1][0], "captured": True}
    with_dropout = [train_on_gpu(SOURCE, monkeypatch, **setting) for _ in range(3)]
    assert with_dropout[0] == with_dropout[1] == with_dropout[2]
    assert with_dropout[0][-1][0]["captured"]


#: Steps that a graph cannot hold, or that it would repeat although they differ.
UNREPEATABLE = {
    "branch by data behind a dropout": "y = F.dropout(self.body(x), 0.1, self.training)\n        "
    "return self.head(y if y.sum() > 0 else -y)",
    "branch by data": "y = self.body(x)\n        return self.head(y if y.sum() > 0 else -y)",
    "number read": "y = self.body(x)\n        return self.head(y * (1 + 0 * y.detach().mean().item()))",
    "draw on the processor": "return self.head(self.body(x)) + (0 * torch.rand(1).to(x) if self.training else 0)",
    **EAGER,
}


@needs_gpu
@pytest.mark.parametrize("body", UNREPEATABLE.values(), ids=UNREPEATABLE)
def test_gpu_trains_eagerly_what_it_cannot_record(body: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the weights that it has without an attempt, and the process goes on after one that failed."""
    source = PLAIN.replace(BODY, body)
    attempted, eager = train_on_gpu(source, monkeypatch), train_on_gpu(source, monkeypatch, captured=False)
    assert attempted[-1][0] == {**eager[-1][0], "captured": False}


@needs_gpu
def test_gpu_tells_a_loss_that_is_not_finite(monkeypatch: pytest.MonkeyPatch) -> None:
    """The candidate is rejected as in the eager loop."""
    source = PLAIN.replace(BODY, "return self.head(self.body(x)) * 1e30")
    assert train_on_gpu(source, monkeypatch)[-1][0]["rejection"]["reason"] == Reason.not_finite.value
