"""Moves that leave a choice to chance: what temperature adds, and how open-ended instructions are met.

Only integers and `Generator.random` are drawn, whose bits are equal on every CPU.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from tacevo.llm.grammar import moves
from tacevo.llm.grammar.bounds import MAX_GRID, MAX_HALVINGS, fit
from tacevo.llm.grammar.network import Activation, Attention, Down, Network, Norm, Pooling

_Option = TypeVar("_Option")

#: A move whose details the generator settles.
Variation = Callable[[Network, np.random.Generator], Network]

#: The most edits that temperature adds.
MOST_EDITS = 4

#: The most edits between the start of a random walk and the network that it draws.
FARTHEST = 24


def pick(rng: np.random.Generator, options: Sequence[_Option]) -> _Option:
    """Choose one of several options, each with equal probability."""
    return options[int(rng.integers(len(options)))]


def vary(network: Network, variations: Sequence[Variation], rng: np.random.Generator) -> Network:
    """Apply one variation: the first, in random order, that changes the network within the bounds, if one does."""
    for index in rng.permutation(len(variations)):
        changed = fit(variations[int(index)](network, rng))
        if changed != network:
            return changed
    return network


def draw_edits(temperature: float, rng: np.random.Generator) -> int:
    """Draw how many small edits a temperature T in [0, 1] adds: each of four happens with probability T / 2."""
    return sum(rng.random() < temperature / 2 for _ in range(MOST_EDITS))


def warm(network: Network, temperature: float, rng: np.random.Generator) -> Network:
    """Add the small random edits of a temperature.

    T changes the number of edits and not their order: a warmer network has the edits of a colder one, and then more.
    """
    for _ in range(draw_edits(temperature, rng)):
        network = vary(network, SMALL_EDITS, rng)
    return network


def wander(network: Network, rng: np.random.Generator) -> Network:
    """Draw a network at random: a walk of 1 to 24 small edits from the given one, each number of them as likely.

    The edits are those of a search, so that a control without selection differs from it in the selection. Networks
    whose parts are all drawn by themselves are mostly beyond the bounds, and large (docs/grammar.md).
    """
    for _ in range(int(rng.integers(1, FARTHEST + 1))):
        network = vary(network, SMALL_EDITS, rng)
    return network


def _one_of(options: Sequence[_Option], move: Callable[[Network, _Option], Network]) -> Variation:
    """Make the variation that gives a move one of several values."""
    return lambda network, rng: move(network, pick(rng, options))


def _resize_block(network: Network, rng: np.random.Generator) -> Network:
    number = _any_block(network, rng)
    return moves.scale_channels(network, pick(rng, (0.75, 1.25)), [number])


def _change_kernel(network: Network, rng: np.random.Generator) -> Network:
    kernel = pick(rng, (3, 5, 7))
    return moves.set_blocks(network, [_any_block(network, rng)], kernel=kernel)


def _change_activation(network: Network, rng: np.random.Generator) -> Network:
    return moves.set_activation(network, pick(rng, tuple(Activation)), trunk=pick(rng, (True, False)))


def _change_grid(network: Network, rng: np.random.Generator) -> Network:
    return replace(network, grid=min(MAX_GRID, max(2, network.grid + pick(rng, (-1, 1)))))


def _attend_in_block(network: Network, rng: np.random.Generator) -> Network:
    attention = pick(rng, tuple(Attention))
    return moves.set_blocks(network, [_any_block(network, rng)], attention=attention)


def _bypass_block(network: Network, rng: np.random.Generator) -> Network:
    target = _later_block(network, rng)
    return moves.add_skip(network, target - 1, target)


def _drop_skip(network: Network, rng: np.random.Generator) -> Network:
    if not network.skips:
        return network
    gone = pick(rng, network.skips)
    return replace(network, skips=tuple(skip for skip in network.skips if skip != gone))


def _separate_block(network: Network, rng: np.random.Generator) -> Network:
    # Not the first: filtering each image channel by itself leaves it next to nothing to learn from.
    return moves.separate(network, [_later_block(network, rng)])


def _join_block(network: Network, rng: np.random.Generator) -> Network:
    return moves.set_blocks(network, [_any_block(network, rng)], separable=False)


def _add_block(network: Network, rng: np.random.Generator) -> Network:
    """Double a block: behind it comes one of its kind that halves the map only if there is room for that."""
    number = _any_block(network, rng)
    original = network.blocks[number - 1]
    halvings = sum(block.down is not Down.none for block in network.blocks)
    down = original.down if halvings < MAX_HALVINGS and pick(rng, (True, False)) else Down.none
    return moves.insert_block(network, number, replace(original, down=down))


def _drop_any_block(network: Network, rng: np.random.Generator) -> Network:
    return moves.drop_block(network, _any_block(network, rng))


def _stride_trunk(network: Network, rng: np.random.Generator) -> Network:
    return moves.set_downsampling(network, Down.stride)


def _drop_hidden(network: Network, rng: np.random.Generator) -> Network:
    return moves.drop_hidden(network)


def _with_layer_norms(network: Network, wanted: bool) -> Network:
    return moves.edit_hidden(network, lambda layer: replace(layer, layer_norm=wanted))


def _with_dropout_at_most(network: Network, rate: float) -> Network:
    return moves.edit_hidden(network, lambda layer: replace(layer, dropout=min(layer.dropout, rate)))


def _any_block(network: Network, rng: np.random.Generator) -> int:
    return int(rng.integers(1, len(network.blocks) + 1))


def _later_block(network: Network, rng: np.random.Generator) -> int:
    """Choose a block behind conv1, or conv1 where it is the only one."""
    return int(rng.integers(min(2, len(network.blocks)), len(network.blocks) + 1))


_change_norm = _one_of(tuple(Norm), lambda network, norm: moves.set_blocks(network, norm=norm))
_change_layer_norm = _one_of((True, False), _with_layer_norms)
_ease_dropout = _one_of((0.1, 0.2), _with_dropout_at_most)
_resize_hidden = _one_of((0.5, 0.75, 1.25, 1.5), moves.scale_hidden)
_change_downsampling = _one_of((Down.max, Down.average, Down.stride), moves.set_downsampling)
_change_dropout = _one_of((0.1, 0.2, 0.3, 0.4, 0.5), moves.set_dropout)
_change_pooling = _one_of(tuple(Pooling), lambda network, pooling: replace(network, pooling=pooling))
_change_attention = _one_of(tuple(Attention), lambda network, attention: replace(network, attention=attention))
_narrow_trunk = _one_of((0.5, 0.75), moves.scale_channels)
_widen_trunk = _one_of((1.25, 1.5), moves.scale_channels)
_lighten_head = _one_of((0.25, 0.5), moves.scale_hidden)
_coarsen_grid = _one_of((2, 3), lambda network, grid: replace(network, grid=min(network.grid, grid)))
_add_hidden = _one_of((64, 128, 256), moves.add_hidden)

#: The variations that temperature adds: one part of the network, changed a little.
SMALL_EDITS: tuple[Variation, ...] = (
    _resize_block,
    _change_kernel,
    _change_activation,
    _change_norm,
    _resize_hidden,
    _change_layer_norm,
    _change_downsampling,
    _change_dropout,
    _change_grid,
    _change_pooling,
    _change_attention,
    _attend_in_block,
    _bypass_block,
    _drop_skip,
    _separate_block,
    _join_block,
    _add_block,
    _drop_any_block,
    _add_hidden,
    _drop_hidden,
)

#: The variations that make a network smaller or faster.
CHEAPER: tuple[Variation, ...] = (
    _narrow_trunk,
    _lighten_head,
    _coarsen_grid,
    _stride_trunk,
    _separate_block,
    _drop_any_block,
    _drop_hidden,
)

#: The variations that practice expects to lower the error.
STRONGER: tuple[Variation, ...] = (
    _widen_trunk,
    _change_norm,
    _change_activation,
    _change_layer_norm,
    _change_attention,
    _attend_in_block,
    _bypass_block,
    _add_block,
    _add_hidden,
    _ease_dropout,
    _change_pooling,
)
