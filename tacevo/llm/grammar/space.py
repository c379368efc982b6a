"""The grammar within a closed space: what its answers become where every network must be a member.

A genome is a value of each gene of `tacevo.space.Space`, by name.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from itertools import product
from typing import TypeVar

import numpy as np

from tacevo.llm.grammar.instructions import follow
from tacevo.llm.grammar.network import (
    Activation,
    Block,
    Down,
    Head,
    Hidden,
    Network,
    Norm,
    Pooling,
    Signature,
)
from tacevo.llm.grammar.variations import FARTHEST, draw_edits, pick
from tacevo.space import Space

Genome = Mapping[str, int | float | str]

T = TypeVar("T")

#: Channels of a block over those of the first; later blocks are as wide as the last of these.
_FACTORS = (1, 2, 4, 4)

#: Blocks that halve the map.
_HALVINGS = 3

_GRID = 4

#: The bypass of the second block.
_BYPASS = ((1, 2),)

#: Draws until a child differs from its parents; alike parents may have no such child.
_ATTEMPTS = 6


def genomes(space: Space) -> Iterator[Genome]:
    """Yield every genome of a space, in the order of its choices; the last gene changes first."""
    choices = _choices(space)
    for values in product(*choices.values()):
        yield dict(zip(choices, values, strict=True))


def member(genome: Genome, signature: Signature) -> Network:
    """Build the network of a genome, with these names and defaults."""
    activation, depth, width = Activation[str(genome["activation"])], int(genome["depth"]), int(genome["width"])
    norm, down = Norm[str(genome["norm"])], Down[str(genome["down"])]
    blocks = tuple(
        Block(
            channels=width * _factor(index),
            norm=norm,
            activation=activation,
            down=down if index < _HALVINGS else Down.none,
        )
        for index in range(depth)
    )
    hidden = Hidden(width=int(genome["hidden"]), activation=activation, dropout=float(genome["dropout"]))
    return Network(
        signature=signature,
        blocks=blocks,
        skips=_BYPASS if genome["residual"] else (),
        pooling=Pooling[str(genome["pooling"])],
        grid=_GRID,
        head=Head(hidden=(hidden,)),
    )


def nearest(space: Space, network: Network, parent: Genome | None = None) -> Genome:
    """Snap each gene of a network to its nearest value in a space.

    What the space does not know stays as in the parent's genome, or becomes the first value. Of two values equally
    near, the one that the parent does not have is taken, because the network was asked to change.
    """
    had = parent or {name: values[0] for name, values in _choices(space).items()}
    read = _genes(network)
    return {name: _nearest(name, values, read[name], had[name]) for name, values in _choices(space).items()}


def mutated(space: Space, parent: Network, instruction: str, temperature: float, rng: np.random.Generator) -> Network:
    """Do what `instructions.transform` does, within a space."""
    own = child = nearest(space, parent)
    for _ in range(_ATTEMPTS):  # an aim may have taken a way that ends where it began
        child = nearest(space, follow(parent, instruction, rng), own)
        if child != own:
            break
    return member(_warm(space, child, temperature, rng), parent.signature)


def crossed(space: Space, first: Network, second: Network, temperature: float, rng: np.random.Generator) -> Network:
    """Take each gene from either parent; the child has the names of the first, and differs from both if it can."""
    one, other = nearest(space, first), nearest(space, second)
    child = one
    for _ in range(_ATTEMPTS):
        child = {name: pick(rng, (one, other))[name] for name in one}
        if child not in (one, other):
            break
    return member(_warm(space, child, temperature, rng), first.signature)


def wandered(space: Space, network: Network, rng: np.random.Generator) -> Network:
    """Do what `variations.wander` does, within a space."""
    genome = nearest(space, network)
    for _ in range(int(rng.integers(1, FARTHEST + 1))):
        genome = _edited(space, genome, rng)
    return member(genome, network.signature)


def _warm(space: Space, genome: Genome, temperature: float, rng: np.random.Generator) -> Genome:
    """Do what `variations.warm` does, each edit of one gene."""
    for _ in range(draw_edits(temperature, rng)):
        genome = _edited(space, genome, rng)
    return genome


def _edited(space: Space, genome: Genome, rng: np.random.Generator) -> Genome:
    """Give one gene another of its values."""
    others = {
        name: [value for value in values if value != genome[name]]
        for name, values in _choices(space).items()
        if len(values) > 1
    }
    if not others:
        return genome
    name = pick(rng, tuple(others))
    return {**genome, name: pick(rng, others[name])}


def _choices(space: Space) -> dict[str, tuple[int | float | str, ...]]:
    return {field.name: getattr(space, field.name) for field in fields(space)}


def _factor(index: int) -> int:
    return _FACTORS[min(index, len(_FACTORS) - 1)]


def _genes(network: Network) -> dict[str, int | float | str | None]:
    """Read the genes of any network, whether a space knows their values or not; None where it has no such part."""
    blocks, hidden = network.blocks, network.head.hidden
    activations = [*(block.activation for block in blocks), *(layer.activation for layer in hidden)]
    downs = [block.down.name for block in blocks if block.down is not Down.none]
    return {
        "depth": len(blocks),
        "width": sum(block.channels / _factor(index) for index, block in enumerate(blocks)) / len(blocks),
        "activation": _usual(activation.name for activation in activations),
        "norm": _usual(block.norm.name for block in blocks),
        "down": _usual(downs),
        "residual": bool(network.skips),
        "pooling": network.pooling.name,
        "hidden": hidden[0].width if hidden else None,
        "dropout": max((layer.dropout for layer in hidden), default=0.0),
    }


def _usual(values: Iterable[T]) -> T | None:
    """Return the most common value, of several the first."""
    common = Counter(values).most_common(1)
    return common[0][0] if common else None


def _nearest(
    name: str, values: tuple[int | float | str, ...], read: int | float | str | None, had: int | float | str
) -> int | float | str:
    if read in values:
        assert read is not None
        return read
    if read is None or isinstance(read, str):
        return had
    widths = name in {"width", "hidden"}

    def distance(value: int | float | str) -> tuple[float, bool]:
        number = float(value)
        apart = max(number / read, read / number) if widths else abs(number - read)
        return apart, value == had

    return min(values, key=distance)
