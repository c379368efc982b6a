"""The trainings that are compared between CPUs: short ones of the baselines and of the networks in `sources/`."""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from tacevo.config.conf_folder import conf_root
from tacevo.randomness import stream
from tacevo.records import Contract, Json, Kind, Limits, Loss, Recipe, to_json
from tacevo.reproduce.bits.operations import digest
from tacevo.training import trainer

#: What was computed, and 64 hex digits of SHA-256 of its bits.
Digests = Iterator[tuple[str, str]]

#: Texts of networks that use every form of layer that language models and the grammar wrote.
SOURCES = Path(__file__).parent / "sources"

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


def convolutions() -> Digests:
    """Compute the convolutions that depend on the sizes of the caches, and their gradients."""
    for shape in SPLIT:
        yield f"convolution {shape}", _convolved(shape)


def steps(counts: Mapping[int, int]) -> Digests:
    """Take so many steps, by the size of the images in pixels, with a network like the baselines."""
    for size, count in counts.items():
        yield f"{size} px, {count} steps", _stepped(size, count)


def trainings() -> Digests:
    """Train each candidate for a moment."""
    for name, source, task in candidates():
        frames = trained(source, task)
        yield f"{name}: training", digest([json.dumps(header).encode() + payload for header, payload in frames])


def candidates() -> Iterator[tuple[str, str, Contract]]:
    """Return what is trained: name, source and contract."""
    for task, loss, outputs in (
        ("force", Loss.mse, 3),
        ("grating", Loss.cross_entropy, 7),
        ("hardness", Loss.mse, 3),
    ):
        source = (conf_root() / "library" / task / "baseline.py").read_text(encoding="utf-8")
        yield f"baseline of {task}", source, _contract(source, loss, outputs)
    for path in sorted(SOURCES.glob("*.py.txt")):
        source = path.read_text(encoding="utf-8")
        yield path.name.partition(".")[0], source, _contract(source, Loss.mse, 3)


def _contract(source: str, loss: Loss, outputs: int) -> Contract:
    """Return the contract of a network of 32 pixels, by the names in its text."""
    (name,) = re.findall(r"^class (\w+)\(nn.Module\)", source, re.MULTILINE)[-1:]
    (argument,) = re.findall(r"in_channels=3, (\w+)=", source)[-1:]
    return Contract(
        class_name=name,
        kind=Kind.regression if loss is Loss.mse else Kind.classification,
        loss=loss,
        in_channels=3,
        image_size=32,
        outputs=outputs,
        output_argument=argument,
    )


def trained(source: str, task: Contract) -> list[tuple[Json, bytes]]:
    """Train for one epoch of two steps at 32 pixels."""
    frames: list[tuple[Json, bytes]] = []
    images = stream(0, "images").integers(0, 256, (24, 3, 32, 32), dtype=np.uint8)
    rows = np.arange(24)
    header = {
        **{"source": source, "contract": to_json(task), "recipe": to_json(RECIPE), "seed": 0},
        **{"mean": [127.5] * 3, "deviation": [74.0] * 3, "train": 16, "validation": 8},
    }
    payload = rows.tobytes() + targets(task)[:16].tobytes()
    trainer.run(header, payload, {"images": images}, lambda head, data: frames.append((head, data)))
    return frames


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
