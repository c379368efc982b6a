"""Parts of the tests' own, with which the core searches where none of ours can be imported: a source and a provider."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacevo.parts.provider import Keep
from tacevo.parts.source import Catalogue
from tacevo.randomness import stream
from tacevo.records import Completion, Json, Kind, Request, to_json
from tacevo.storage.canonical import content_hash


@dataclass(frozen=True)
class Touches:
    """A bright spot for each touch: it lies where the force points to, and is as large as the force is strong."""

    image_size: int
    images: int
    seed: int

    def describe(self) -> Json:
        """Name everything that decides the images."""
        return {"source": "touches", "images": self.images, "image_size": self.image_size, "seed": self.seed}

    def catalogue(self) -> Catalogue:
        """List the touches."""
        forces = stream(self.seed, "touches").uniform([-1, -1, 0.2], [1, 1, 2], (self.images, 3))
        return Catalogue(
            kind=Kind.regression,
            names=("Fx", "Fy", "Fz"),
            units=("N", "N", "N"),
            labels=forces,
            image_size=self.image_size,
            pictures=[partial(self._picture, force) for force in forces],
        )

    def _picture(self, force: NDArray[np.float64]) -> NDArray[np.uint8]:
        x, y, z = force
        rows, columns = np.mgrid[0 : self.image_size, 0 : self.image_size] / self.image_size
        spot = (rows - 0.5 - 0.3 * y) ** 2 + (columns - 0.5 - 0.3 * x) ** 2 < (0.15 * z) ** 2
        return np.repeat(np.where(spot, 220, 30).astype(np.uint8)[None], 3, axis=0)


_NETWORK = '''\
class {name}(nn.Module):
    """Drawn for a test."""

    def __init__(self, in_channels=3, {outputs}={number}):
        super().__init__()
        self.features = nn.Sequential(
            nn.Conv2d(in_channels, {first}, kernel_size={kernel}, padding={kernel} // 2),
            nn.{activation}(),
            nn.{pooling}(2),
            nn.Conv2d({first}, {second}, kernel_size=3, padding=1),
            nn.{activation}(),
            nn.{pooling}(2),
        )
        self.pool = nn.AdaptiveAvgPool2d(({size}, {size}))
        self.head = nn.Linear({second} * {size} * {size}, {outputs})

    def forward(self, x):
        x = self.features(x)
        return self.head(self.pool(x).flatten(1))
'''

_CLASS = re.compile(r"class (?P<name>\w+)\(nn\.Module\).*?in_channels=3, (?P<outputs>\w+)=(?P<number>\d+)", re.DOTALL)

#: What models do wrong: what is replaced in an answer, and by what.
_FAULTS = (
    (r"```python.*```", "I would make it deeper."),
    (r"super\(\).__init__\(\)", "super().__init__("),
    (r"from torch", "import os\nfrom torch"),
    (r"self\.head\(", "self.tail("),
    (r"return .*", "return x"),
)


@dataclass(frozen=True)
class Drawn:
    """Answers with a network of two convolutions that the request draws; a part of the answers is no network."""

    model: str
    slip_rate: float

    def complete(self, requests: Sequence[Request], keep: Keep) -> Iterator[tuple[int, Completion]]:
        """Answer the requests in their order; equal requests have equal answers."""
        for position, request in enumerate(requests):
            yield position, keep(request, self._answer(request))

    def _answer(self, request: Request) -> Completion:
        asked = content_hash(to_json(replace(request, settings=(), temperature=0.0)))
        parent = _CLASS.search(request.messages[0].content)
        assert parent is not None, request.messages[0].content
        rng = stream(0, "drawn", asked)
        drawn: dict[str, Any] = {
            "first": rng.choice([4, 8, 16, 32]),
            "second": rng.choice([8, 16, 32, 64]),
            "kernel": rng.choice([3, 5]),
            "size": rng.choice([1, 2, 4]),
            "activation": rng.choice(["ReLU", "GELU", "SiLU"]),
            "pooling": rng.choice(["MaxPool2d", "AvgPool2d"]),
        }
        text = f"```python\nfrom torch import nn\n\n\n{_NETWORK.format(**parent.groupdict(), **drawn)}```\n"
        if rng.random() < self.slip_rate:
            text = re.sub(*_FAULTS[rng.integers(len(_FAULTS))], text, flags=re.DOTALL)
        return Completion(
            text=text,
            model=self.model,
            stop_reason="end_turn",
            input_tokens=len(request.system),
            output_tokens=len(text),
        )
