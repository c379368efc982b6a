"""Typed moves: small changes of a network, each a pure function that returns a new one.

A move that has nothing to act on returns the network unchanged. Blocks are counted from 1, as in `conv1`.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from tacevo.llm.grammar.bounds import MAX_BLOCKS, MAX_HIDDEN_LAYERS, MAX_SKIPS, MIN_BLOCKS
from tacevo.llm.grammar.network import Activation, Block, Down, Hidden, Network


def all_blocks(network: Network) -> range:
    """Number every block: 1, 2, ..."""
    return range(1, len(network.blocks) + 1)


def edit_blocks(network: Network, edit: Callable[[Block], Block], which: Iterable[int] | None = None) -> Network:
    """Change the blocks of the given numbers, or every block."""
    chosen = set(all_blocks(network) if which is None else which)
    blocks = tuple(edit(block) if number in chosen else block for number, block in enumerate(network.blocks, start=1))
    return replace(network, blocks=blocks)


def set_blocks(network: Network, which: Iterable[int] | None = None, **parts: Any) -> Network:
    """Give the blocks of the given numbers, or every block, the same parts."""
    return edit_blocks(network, lambda block: replace(block, **parts), which)


def separate(network: Network, which: Iterable[int]) -> Network:
    """Make the convolutions of blocks depthwise separable, where their kernel is larger than a position."""
    return edit_blocks(network, lambda block: replace(block, separable=block.kernel > 1), which)


def set_head(network: Network, **parts: Any) -> Network:
    """Give the head other parts."""
    return replace(network, head=replace(network.head, **parts))


def edit_hidden(network: Network, edit: Callable[[Hidden], Hidden]) -> Network:
    """Change every hidden layer of the head."""
    return set_head(network, hidden=tuple(edit(layer) for layer in network.head.hidden))


def scale_channels(network: Network, factor: float, which: Iterable[int] | None = None) -> Network:
    """Multiply the channels of the blocks of the given numbers, or of every block."""
    return edit_blocks(network, lambda block: replace(block, channels=round(block.channels * factor)), which)


def scale_hidden(network: Network, factor: float) -> Network:
    """Multiply the widths of the hidden layers."""
    return edit_hidden(network, lambda layer: replace(layer, width=round(layer.width * factor)))


def set_hidden(network: Network, width: int) -> Network:
    """Give the first hidden layer a width, or the head such a layer if it has none."""
    first, *others = network.head.hidden or (Hidden(width=width),)
    return set_head(network, hidden=(replace(first, width=width), *others))


def add_hidden(network: Network, width: int) -> Network:
    """Append a hidden layer that looks like the last one but has no dropout."""
    layers = network.head.hidden
    if len(layers) >= MAX_HIDDEN_LAYERS:
        return network
    last = layers[-1] if layers else Hidden(width=width)
    return set_head(network, hidden=(*layers, replace(last, width=width, dropout=0.0)))


def drop_hidden(network: Network) -> Network:
    """Take away the last hidden layer, unless it is the only one."""
    layers = network.head.hidden
    return network if len(layers) < 2 else set_head(network, hidden=layers[:-1])


def set_activation(network: Network, activation: Activation, *, trunk: bool = True, head: bool = True) -> Network:
    """Use one activation throughout the trunk, the head, or both."""
    if trunk:
        network = set_blocks(network, activation=activation)
    return edit_hidden(network, lambda layer: replace(layer, activation=activation)) if head else network


def set_downsampling(network: Network, down: Down) -> Network:
    """Change how the blocks that halve the map do so; the others keep its size."""
    return edit_blocks(network, lambda block: block if block.down is Down.none else replace(block, down=down))


def set_dropout(network: Network, rate: float) -> Network:
    """Give each dropout of the head a rate; one without any gets one in the last hidden layer, or at its input."""
    head = network.head
    if head.input_dropout or any(layer.dropout for layer in head.hidden):
        network = edit_hidden(network, lambda layer: replace(layer, dropout=rate) if layer.dropout else layer)
        return set_head(network, input_dropout=rate if head.input_dropout else 0.0)
    if head.hidden:
        return set_head(network, hidden=(*head.hidden[:-1], replace(head.hidden[-1], dropout=rate)))
    return set_head(network, input_dropout=rate)


def add_dropout(network: Network, rate: float) -> Network:
    """Add a dropout layer at the first free place: a hidden layer, the head's input, a block."""
    head = network.head
    for index, layer in enumerate(head.hidden):
        if not layer.dropout:
            hidden = (*head.hidden[:index], replace(layer, dropout=rate), *head.hidden[index + 1 :])
            return set_head(network, hidden=hidden)
    if not head.input_dropout:
        return set_head(network, input_dropout=rate)
    free = [number for number in all_blocks(network) if not network.blocks[number - 1].dropout]
    # Dropping whole channels costs more information than dropping single features, so the rate is smaller.
    return set_blocks(network, free[-1:], dropout=round(rate / 2, 3))


def remove_head_dropout(network: Network) -> Network:
    """Take every dropout out of the head."""
    return set_head(edit_hidden(network, lambda layer: replace(layer, dropout=0.0)), input_dropout=0.0)


def add_skip(network: Network, source: int, target: int) -> Network:
    """Add the output of block `source` (0: the image) to the output of block `target`."""
    skips = sorted({*network.skips, (source, target)})
    return network if len(skips) > MAX_SKIPS else replace(network, skips=tuple(skips))


def insert_block(network: Network, after: int, block: Block) -> Network:
    """Put a block behind the given one; skips keep joining the blocks that they joined."""
    if len(network.blocks) >= MAX_BLOCKS:
        return network
    skips = tuple((source + (source > after), target + (target > after)) for source, target in network.skips)
    return replace(network, blocks=(*network.blocks[:after], block, *network.blocks[after:]), skips=skips)


def drop_block(network: Network, number: int) -> Network:
    """Take a block away, with the skips that begin or end at it, unless too few would be left."""
    if len(network.blocks) <= MIN_BLOCKS:
        return network
    skips = tuple(
        (source - (source > number), target - (target > number))
        for source, target in network.skips
        if number not in {source, target}
    )
    blocks = network.blocks[: number - 1] + network.blocks[number:]
    return replace(network, blocks=blocks, skips=skips)
