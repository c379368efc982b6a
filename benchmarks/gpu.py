"""What a GPU makes of the paper's setting: images a second beside what the device can do, and candidates an hour.

    python -m benchmarks.gpu

For the baseline and four networks of the first published force run, at 256 px, in each precision: images/s of the
trainer in one process, each step run eagerly, and one step captured and replayed in either layout. Beside it the two
limits that the device has for that network: its arithmetic, by the rate of a large matrix product, and its memory, by
the rate of a large copy. Beside that the memory that is predicted of a training, and what it takes; and baselines an
hour through the whole sandbox, with one, two and four on the GPU at once.
Without CUDA it says so and measures nothing. benchmarks/README.md has what it said of an H200.
"""

import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from tacevo.bundles.open import opened
from tacevo.choices import Device, Layout, Numerics, Precision
from tacevo.config.compose import compose
from tacevo.errors import RunError
from tacevo.gate.probe import run as probe
from tacevo.profile import Profile
from tacevo.records import Contract, Gpu, to_json, written
from tacevo.results.run import read_run
from tacevo.runs.answers import task_without_data
from tacevo.runs.pace import measure
from tacevo.runs.wiring import recipe_of
from tacevo.sandbox.candidate import build
from tacevo.text import table
from tacevo.training.captured import Capture, capture
from tacevo.training.gpu import Resident, multiply_in
from tacevo.training.memory import predicted_mib
from tacevo.training.numerics import environment
from tacevo.training.trainer import run
from tacevo.typed import convert

PUBLISHED = Path("tests/golden/bundles/force-grammar.zip")

#: Of the paper's searches.
SIZE, BATCH, EPOCHS, IMAGES = 256, 32, 10, 2400

#: How the whole sandbox is measured, besides the GPU's model.
SETTING = (
    "experiment=paper_force",
    "llm=grammar",
    "training.device=cuda",
    "sandbox.require=none",
    "numerics=fast",
)

#: Steps of a timed training, beyond those of the short one that it is compared with.
STEPS = 40

#: An activation is written and read going forward and read going back; its gradient is written and read: at least.
_PASSES = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a device can do."""

    #: FLOP/s of a matrix product, a multiplication and an addition counted as two.
    arithmetic: float
    #: Bytes a second that are read and written by a copy.
    traffic: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Work:
    """What an image asks for, forward and backward."""

    flops: float
    #: Bytes of activations, if each is moved as seldom as possible and no two layers are computed as one.
    traffic: float

    def bound(self, limits: Limits) -> tuple[float, str]:
        """Return the most images a second, and what sets the limit."""
        return min((limits.arithmetic / self.flops, "arithmetic"), (limits.traffic / self.traffic, "memory"))


def networks(count: int = 4, published: Path = PUBLISHED) -> Iterator[tuple[str, str]]:
    """Yield name and source of a run's baseline, and of so many candidates from the fewest FLOPs to the most."""
    bundle = opened(published)
    (path,) = bundle.runs
    trained = sorted(read_run(path).trained, key=lambda line: line.flops or 0)
    chosen = [trained[round(place * (len(trained) - 1) / (count - 1))] for place in range(count)]
    for name, line in [("baseline", None), *((line.id, line) for line in chosen)]:
        file = "g00s00" if line is None else line.id
        yield name, (path / "candidates" / f"{file}.py").read_text(encoding="utf-8")


def work_of(source: str, contract: Contract) -> Work:
    """Count what a network computes and moves, on a CPU, for one image."""
    model, moved = build(source, contract, 0).eval(), 0

    def note(module: nn.Module, inputs: Any, output: Any) -> None:
        nonlocal moved
        if isinstance(output, torch.Tensor) and not list(module.children()):
            moved += output.numel() * output.element_size()

    for module in model.modules():
        module.register_forward_hook(note)
    images = torch.zeros(1, contract.in_channels, contract.image_size, contract.image_size)
    with FlopCounterMode(display=False) as counted:
        model(images).sum().backward()
    return Work(flops=float(counted.get_total_flops()), traffic=float(_PASSES * moved))


def limits(device: torch.device, precision: Precision, *, side: int = 8192, rounds: int = 10) -> Limits:
    """Time a matrix product and a copy, each of `side` x `side` values."""
    multiply_in(precision)
    kind = torch.bfloat16 if precision is Precision.bf16 else torch.float32
    one, two = (torch.rand(side, side, device=device).to(kind) for _ in range(2))
    product = _timed(lambda: torch.mm(one, two), device, rounds)
    copied = torch.empty_like(one)
    copy = _timed(lambda: copied.copy_(one), device, rounds)
    return Limits(arithmetic=2 * side**3 / product, traffic=2 * one.numel() * one.element_size() / copy)


def images_per_second(
    source: str,
    contract: Contract,
    device: torch.device,
    precision: Precision,
    *,
    layout: Layout = Layout.contiguous,
    capture: Capture | None = None,
    steps: int = STEPS,
    batch: int = BATCH,
) -> float:
    """Time the trainer's steps, images resident on the device, without its start and its predictions.

    With `capture` one step is recorded and replayed, else each runs eagerly.
    """
    gpu = Gpu(model="any", precision=precision, memory_mib=8192, layout=layout, captured=capture is not None)
    multiply_in(precision)
    rng, size = np.random.default_rng(0), (2 * batch, contract.in_channels, contract.image_size, contract.image_size)
    images = Resident(rng.integers(0, 256, size, dtype=np.uint8), np.arange(2 * batch), device)

    def train(count: int) -> None:
        """Train for one epoch of so many steps on the same few images, and predict one."""
        rows = np.resize(np.arange(2 * batch), count * batch)
        targets = rng.random((len(rows), contract.outputs), dtype=np.float32)
        payload = rows.tobytes() + rows[:1].tobytes() + targets.tobytes()
        recipe = replace(recipe_of(compose([])), epochs=1, batch_size=batch, gpu=gpu)
        header = {
            "source": source,
            "contract": written(contract),
            "recipe": written(recipe),
            "seed": 0,
            "mean": [127.5] * contract.in_channels,
            "deviation": [74.0] * contract.in_channels,
            "train": len(rows),
            "validation": 1,
            "device": device.type,
        }
        ends: list[Any] = []
        arrays = {"images": images, **({} if capture is None else {"capture": capture})}
        run(header, payload, arrays, lambda head, _: ends.append(head))
        if "rejection" in ends[-1]:
            raise RuntimeError(f"expected a training; got {ends[-1]['rejection']}")

    train(1)  # so that kernels are chosen and memory is taken
    short, long = (_timed(lambda count=count: train(count), device, 1) for count in (1, 1 + steps))  # type: ignore[misc]
    return steps * batch / (long - short)


def one_process(
    device: torch.device,
    sources: Mapping[str, str],
    *,
    size: int = SIZE,
    side: int = 8192,
    steps: int = STEPS,
    batch: int = BATCH,
) -> str:
    """Measure each network, by name and source, in each precision; return a table."""
    _, task = task_without_data("force", size)
    how: dict[str, dict[str, Any]] = {"eager": {}}
    if device.type == "cuda":
        how |= {f"captured, {layout}": {"layout": layout, "capture": capture} for layout in Layout}
    rows = []
    for precision in Precision:
        can = limits(device, precision, side=side)
        for name, source in sources.items():
            work = work_of(source, task.contract)
            bound, what = work.bound(can)
            rates = [
                images_per_second(source, task.contract, device, precision, steps=steps, batch=batch, **changes)
                for changes in how.values()
            ]
            reached = [f"{bound:,.0f}", what, f"{max(rates) / bound:.0%}"]
            rows.append(
                [name, precision.value, f"{work.flops / 1e9:.2f}", *(f"{rate:,.0f}" for rate in rates), *reached]
            )
    return table(["network", "precision", "GFLOP/image", *how, "limit", "set by", "reached"], rows)


def profile_of(source: str, contract: Contract) -> Profile:
    """Probe a network on the CPU, in this process.

    Raises:
        RunError: the probe rejects it.
    """
    told: list[Any] = []
    limits = dict.fromkeys(("parameters", "flops", "modules"), 2**53)
    probe(
        {"source": source, "contract": to_json(contract), "limits": limits}, b"", {}, lambda head, _: told.append(head)
    )
    profile: Profile = convert(Profile, told[0].get("profile"), place="the probe", error=RunError)
    return profile


def lent(device: torch.device, sources: Mapping[str, str], *, size: int = SIZE, batch: int = BATCH) -> str:
    """Compare the memory that is predicted of a training with what torch takes at most; return a table."""
    _, task = task_without_data("force", size)
    capturing = capture if device.type == "cuda" else None
    rows = []
    for name, source in sources.items():
        recipe = replace(recipe_of(compose([])), batch_size=batch)
        guess = predicted_mib(profile_of(source, task.contract), task.contract, recipe, 2 * batch)
        peak = 0
        if device.type == "cuda":
            torch.cuda.empty_cache()
            torch.cuda.reset_peak_memory_stats()
        images_per_second(source, task.contract, device, Precision.tf32, capture=capturing, steps=1, batch=batch)
        if device.type == "cuda":
            peak = torch.cuda.max_memory_reserved() // 2**20
        told = ["not known", f"{peak:,}", "-"] if guess is None else [f"{guess:,}", f"{peak:,}", f"{peak / guess:.2f}"]
        rows.append([name, *told])
    return table(["network", "MiB predicted", "MiB at most", "of it"], rows)


def whole_sandbox(overrides: Sequence[str], *, at_once: Sequence[int] = (1, 2, 4)) -> str:
    """Measure baselines an hour as a search trains them; return a table."""
    rows = []
    for count in at_once:
        shared = [f"executor.per_gpu={count}"] if "training.device=cuda" in overrides else []  # a test has no GPU
        pace = measure(compose([*overrides, f"executor.workers={count}", *shared]))
        seconds = EPOCHS * IMAGES / pace.images_per_second + (pace.start + pace.gate) / count
        rows.append([str(count), f"{pace.images_per_second:,.0f}", f"{pace.start:.1f}", f"{3600 / seconds:,.0f}"])
    return table(["candidates on the GPU", "images/s in all", "s to start one", "baselines/h"], rows)


def _timed(work: Callable[[], object], device: torch.device, rounds: int) -> float:
    """Return the seconds of one of several rounds, after one that does not count."""
    if rounds > 1:
        work()
    _wait(device)
    began = time.perf_counter()
    for _ in range(rounds):
        work()
    _wait(device)
    return (time.perf_counter() - began) / rounds


def _wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize()


def main() -> int:
    """Measure, where there is a GPU."""
    if not torch.cuda.is_available():
        print("no CUDA device that torch can use; nothing was measured", file=sys.stderr)
        return 2
    os.environ.update(environment(Numerics.fast, Device.cuda))  # cuBLAS reads its own when it starts
    model = torch.cuda.get_device_name(0)
    print(f"{model}, torch {torch.__version__}, {SIZE} px, batches of {BATCH}\n", flush=True)
    print(whole_sandbox([*SETTING, f"training.gpu={model}"]), flush=True)
    print(f"\n{lent(torch.device('cuda'), dict(networks()))}", flush=True)
    print(f"\n{one_process(torch.device('cuda'), dict(networks()))}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
