"""Typed moves: small changes of a network, each a pure function that returns a new one.

A move that has nothing to act on returns the network unchanged. Blocks are counted from 1, as in `conv1`.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace

from tacevo.llm.grammar.bounds import MAX_BLOCKS, MAX_HIDDEN_LAYERS, MAX_SKIPS, MIN_BLOCKS
from tacevo.llm.grammar.network import Activation, Block, Down, Hidden, Network


def all_blocks(network: Network) -> range:
    """Number every block: 1, 2, ..."""
    return range(1, len(network.blocks) + 1)


def edit_blocks(network: Network, which: Iterable[int], edit: Callable[[Block], Block]) -> Network:
    """Change the blocks of the given numbers."""
    chosen = set(which)
    blocks = tuple(edit(block) if number in chosen else block for number, block in enumerate(network.blocks, start=1))
    return replace(network, blocks=blocks)


def edit_hidden(network: Network, edit: Callable[[Hidden], Hidden]) -> Network:
    """Change every hidden layer of the head."""
    return replace(network, head=replace(network.head, hidden=tuple(edit(layer) for layer in network.head.hidden)))


def scale_channels(network: Network, which: Iterable[int], factor: float) -> Network:
    """Multiply the channels of blocks."""
    return edit_blocks(network, which, lambda block: replace(block, channels=round(block.channels * factor)))


def scale_hidden(network: Network, factor: float) -> Network:
    """Multiply the widths of the hidden layers."""
    return edit_hidden(network, lambda layer: replace(layer, width=round(layer.width * factor)))


def set_hidden(network: Network, width: int) -> Network:
    """Give the first hidden layer a width, or the head such a layer if it has none."""
    first, *others = network.head.hidden or (Hidden(width=width),)
    hidden = (replace(first, width=width), *others)
    return replace(network, head=replace(network.head, hidden=hidden))


def add_hidden(network: Network, width: int) -> Network:
    """Append a hidden layer that looks like the last one but has no dropout."""
    layers = network.head.hidden
    if len(layers) >= MAX_HIDDEN_LAYERS:
        return network
    last = layers[-1] if layers else Hidden(width=width)
    hidden = (*layers, replace(last, width=width, dropout=0.0))
    return replace(network, head=replace(network.head, hidden=hidden))


def drop_hidden(network: Network) -> Network:
    """Take away the last hidden layer, unless it is the only one."""
    if len(network.head.hidden) < 2:
        return network
    return replace(network, head=replace(network.head, hidden=network.head.hidden[:-1]))


def set_activation(network: Network, activation: Activation, *, trunk: bool = True, head: bool = True) -> Network:
    """Use one activation throughout the trunk, the head, or both."""
    if trunk:
        network = edit_blocks(network, all_blocks(network), lambda block: replace(block, activation=activation))
    return edit_hidden(network, lambda layer: replace(layer, activation=activation)) if head else network


def set_downsampling(network: Network, down: Down) -> Network:
    """Change how the blocks that halve the map do so; the others keep its size."""
    halving = [number for number in all_blocks(network) if network.blocks[number - 1].down is not Down.none]
    return edit_blocks(network, halving, lambda block: replace(block, down=down))


def set_dropout(network: Network, rate: float) -> Network:
    """Give each dropout of the head a rate, or the last hidden layer a dropout if the head has none."""
    head = network.head
    if not head.input_dropout and not any(layer.dropout for layer in head.hidden):
        return _with_dropout_at_the_end(network, rate)
    hidden = tuple(replace(layer, dropout=rate) if layer.dropout else layer for layer in head.hidden)
    return replace(network, head=replace(head, hidden=hidden, input_dropout=rate if head.input_dropout else 0.0))


def add_dropout(network: Network, rate: float) -> Network:
    """Add a dropout layer at the first free place: a hidden layer, the head's input, a block."""
    head = network.head
    for index, layer in enumerate(head.hidden):
        if not layer.dropout:
            hidden = (*head.hidden[:index], replace(layer, dropout=rate), *head.hidden[index + 1 :])
            return replace(network, head=replace(head, hidden=hidden))
    if not head.input_dropout:
        return replace(network, head=replace(head, input_dropout=rate))
    free = [number for number in all_blocks(network) if not network.blocks[number - 1].dropout]
    # Dropping whole channels costs more information than dropping single features, so the rate is smaller.
    return edit_blocks(network, free[-1:], lambda block: replace(block, dropout=round(rate / 2, 3)))


def remove_head_dropout(network: Network) -> Network:
    """Take every dropout out of the head."""
    network = edit_hidden(network, lambda layer: replace(layer, dropout=0.0))
    return replace(network, head=replace(network.head, input_dropout=0.0))


def remove_dropout(network: Network) -> Network:
    """Take every dropout out of the network."""
    return remove_head_dropout(edit_blocks(network, all_blocks(network), lambda block: replace(block, dropout=0.0)))


def add_skip(network: Network, source: int, target: int) -> Network:
    """Add the output of block `source` (0: the image) to the output of block `target`."""
    skips = sorted({*network.skips, (source, target)})
    return network if len(skips) > MAX_SKIPS else replace(network, skips=tuple(skips))


def insert_block(network: Network, after: int, block: Block) -> Network:
    """Put a block behind the given one; skips keep joining the blocks that they joined."""
    if len(network.blocks) >= MAX_BLOCKS:
        return network
    skips = tuple((_moved(source, after), _moved(target, after)) for source, target in network.skips)
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


def _moved(number: int, after: int) -> int:
    return number + 1 if number > after else number


def _with_dropout_at_the_end(network: Network, rate: float) -> Network:
    """Put a dropout into the last hidden layer, or at the head's input if there is none."""
    head = network.head
    if not head.hidden:
        return replace(network, head=replace(head, input_dropout=rate))
    hidden = (*head.hidden[:-1], replace(head.hidden[-1], dropout=rate))
    return replace(network, head=replace(head, hidden=hidden))
