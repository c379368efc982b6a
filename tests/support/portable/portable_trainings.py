"""The trainings that are compared between CPUs: short ones of the baselines and of the networks in `tests/portable`."""

import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from checkout import LIBRARY, ROOT
from gate_cases import contract
from numpy.typing import NDArray
from portable_operations import operations
from portable_printing import digest, show
from torch import Tensor, nn
from training_jobs import CONTRACT

from tacevo.errors import StoreError
from tacevo.gate import probe
from tacevo.profile import Profile
from tacevo.randomness import stream
from tacevo.records import Contract, Limits, Loss, Recipe, to_json
from tacevo.sandbox.client import Frame
from tacevo.training import trainer
from tacevo.typed import convert

NETWORKS = ROOT / "tests" / "portable"

RECIPE = Recipe(
    epochs=1, batch_size=8, learning_rate=1e-3, optimiser="adam", limits=Limits(seconds=60, memory_mib=1_000)
)

#: Images, channels in and out, image size, kernel and stride of convolutions whose sums oneDNN splits by the sizes of
#: the caches; with other sizes, each of them differed at one of the levels.
SPLIT = (
    *(
        (8, 3, 256, 8, 7, 2),
        (8, 32, 128, 16, 5, 1),
        (8, 128, 32, 8, 7, 1),
        (8, 256, 16, 8, 5, 1),
        (8, 256, 64, 8, 5, 1),
    ),
    *((8, 256, 32, 16, 5, 2), (32, 16, 128, 16, 7, 2), (32, 16, 256, 8, 5, 2), (32, 256, 16, 8, 7, 2)),
)


def bits() -> None:
    """Show what `tests/golden/bits.json` holds: trainings, convolutions, steps at larger sizes, and every operation."""
    show("kernels of ATen", torch.backends.cpu.get_cpu_capability())
    for name, source, task in candidates():
        frames = trained(source, task)
        show(f"{name}: training", digest([json.dumps(frame.header).encode() + frame.payload for frame in frames]))
    convolutions()
    for size, steps in ((64, 1), (128, 1)):
        show(f"{size} px, {steps} steps", _stepped(size, steps))
    operations()


def convolutions() -> None:
    """Show the bits of the convolutions that depend on the sizes of the caches."""
    for shape in SPLIT:
        show(f"convolution {shape}", _convolved(shape))


def steps() -> None:
    """Show the bits of further steps, which were also computed on an Intel Xeon with AVX-512."""
    for size, count in ((32, 63), (64, 27), (128, 11)):
        show(f"{size} px, {count} steps", _stepped(size, count))


def candidates() -> Iterator[tuple[str, str, Contract]]:
    """Return what is trained: name, source and contract."""
    for task in ("force", "grating", "hardness"):
        source = (LIBRARY / task / "baseline.py").read_text(encoding="utf-8")
        yield f"baseline of {task}", source, _contract(source, "grating" if task == "grating" else "force")
    for path in sorted(NETWORKS.glob("*.py.txt")):
        yield path.name.partition(".")[0], path.read_text(encoding="utf-8"), replace(CONTRACT, image_size=32, outputs=3)


def _contract(source: str, kind: str) -> Contract:
    """Return a baseline's contract, with its own class name."""
    (name,) = re.findall(r"^class (\w+)", source, re.MULTILINE)
    (argument,) = re.findall(r"in_channels=3, (\w+)=", source)
    return replace(contract(kind), class_name=name, output_argument=argument)


def probed(source: str, task: Contract) -> Profile:
    """Probe a network."""
    frames: list[Any] = []
    limits = {"parameters": 50_000_000, "flops": 10**10, "modules": 2_000}
    header = {"source": source, "contract": to_json(task), "limits": limits}
    probe.run(header, b"", {}, lambda frame, _: frames.append(frame))
    return convert(Profile, frames[0]["profile"], place="frame", error=StoreError)


def trained(source: str, task: Contract) -> tuple[Frame, ...]:
    """Train for one epoch of two steps at 32 pixels."""
    frames: list[Frame] = []
    images = stream(0, "images").integers(0, 256, (24, 3, 32, 32), dtype=np.uint8)
    rows = np.arange(24)
    header = {
        **{"source": source, "contract": to_json(task), "recipe": to_json(RECIPE), "seed": 0},
        **{"mean": [127.5] * 3, "deviation": [74.0] * 3, "train": 16, "validation": 8},
    }
    payload = rows.tobytes() + targets(task)[:16].tobytes()
    trainer.run(header, payload, {"images": images}, lambda head, data: frames.append(Frame(head, data)))
    return tuple(frames)


def targets(task: Contract) -> NDArray[Any]:
    """Draw labels of 24 images."""
    draws = stream(0, "targets")
    if task.loss is Loss.mse:
        return draws.random((24, task.outputs)).astype(np.float32)
    return draws.integers(0, task.outputs, 24)


def _convolved(shape: tuple[int, ...]) -> str:
    """Compute a convolution of `SPLIT` and its gradients on random images; return the digest of them."""
    images, channels, filters, size, kernel, stride = shape
    draws = torch.Generator().manual_seed(0)
    x = torch.rand(images, channels, size, size, generator=draws).sub_(0.5)
    x = x.to(memory_format=torch.channels_last).requires_grad_()
    torch.manual_seed(0)
    layer = _lying(nn.Conv2d(channels, filters, kernel, stride=stride, padding=kernel // 2))
    y = layer(x)
    y.backward(torch.rand(y.shape, generator=draws).to(memory_format=torch.channels_last))
    return _digest([y, x.grad, *(weights.grad for weights in layer.parameters())])


def _stepped(size: int, steps: int) -> str:
    """Train a network like the baselines for some steps of 32 random images; return the digest of its weights."""
    torch.manual_seed(0)
    draws = torch.Generator().manual_seed(1)
    x = torch.rand(32, 3, size, size, generator=draws).to(memory_format=torch.channels_last)
    y = torch.randint(0, 7, (32,), generator=draws)
    blocks = [
        layer
        for channels, filters in ((3, 32), (32, 64), (64, 128))
        for layer in (
            nn.Conv2d(channels, filters, 3, padding=1),
            nn.BatchNorm2d(filters),
            nn.GELU(),
            nn.MaxPool2d(2),
        )
    ]
    head = [nn.AdaptiveAvgPool2d(4), nn.Flatten(), nn.Linear(2048, 512), nn.ReLU(), nn.Dropout(), nn.Linear(512, 7)]
    network = _lying(nn.Sequential(*blocks, *head))
    optimiser = torch.optim.Adam(network.parameters(), 1e-3, fused=True)
    for _ in range(steps):
        optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(nn.functional.cross_entropy(network(x), y))
        optimiser.step()
    return _digest(network.parameters())


def _lying(module: nn.Module) -> nn.Module:
    """Return the module with its weights in channels_last."""
    return module.to(memory_format=torch.channels_last)  # type: ignore[call-overload,no-any-return]


def _digest(tensors: Iterable[Tensor | None]) -> str:
    return digest([tensor.detach().contiguous().numpy().tobytes() for tensor in tensors if tensor is not None])
