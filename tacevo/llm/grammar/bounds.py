"""The bounds of a network of the grammar, and the changes that bring it back into them."""

from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise

from tacevo.llm.grammar.network import Attention, Block, Down, Hidden, Network, Norm, pooled_features, widths

MIN_BLOCKS, MAX_BLOCKS = 2, 6
MIN_CHANNELS, MAX_CHANNELS = 8, 512
MAX_KERNEL = 7

#: Four halvings leave 2 x 2 positions of a 32-pixel image, the smallest that a task has.
MAX_HALVINGS = 4

MAX_SKIPS = 4
MAX_HIDDEN_LAYERS = 4
MIN_HIDDEN, MAX_HIDDEN = 16, 2048
MAX_GRID = 8
MAX_DROPOUT = 0.8
MAX_PARAMETERS = 20_000_000

#: Multiply-adds of the trunk for each pixel of the image, about six times the baseline's.
MAX_COST = 60_000


def parameters(network: Network) -> int:
    """Count the trainable parameters, all of them."""
    channels = widths(network)
    trunk = sum(_block_parameters(block, inputs) for inputs, block in zip(channels, network.blocks, strict=False))
    skips = sum(
        (channels[source] + 1) * channels[target]
        for source, target in network.skips
        if source == 0 or channels[source] != channels[target]
    )
    return trunk + skips + _attention_parameters(network.attention, channels[-1]) + _head_parameters(network)


def cost(network: Network) -> float:
    """Count the multiply-adds of the trunk's convolutions for each pixel of the image."""
    total, area = 0.0, 1.0
    for inputs, block in zip(widths(network), network.blocks, strict=False):
        if block.down is Down.stride:
            area /= 4
        total += area * _weights(block, inputs)
        if block.down in {Down.max, Down.average}:
            area /= 4
    return total


def fit(network: Network) -> Network:
    """Bring a network within the bounds; one that is within them comes back unchanged.

    Numbers are clipped one by one, surplus blocks, halvings, skips and hidden layers are dropped from the end, and
    what is still too large as a whole is narrowed in steps of a fifth.
    """
    network = _clipped(network)
    while parameters(network) > MAX_PARAMETERS or cost(network) > MAX_COST:
        narrower = _narrowed(network)
        if narrower == network:
            break
        network = narrower
    return network


def clip(value: int, low: int, high: int) -> int:
    """Move a value to the nearest one in [low, high]."""
    return max(low, min(high, value))


def _clipped(network: Network) -> Network:
    """Bring every number and every count within its own bounds."""
    blocks = _with_few_halvings(_clipped_block(block) for block in network.blocks[:MAX_BLOCKS])
    skips = tuple(skip for skip in network.skips if skip[1] <= len(blocks))[:MAX_SKIPS]
    hidden = tuple(_clipped_hidden(layer) for layer in network.head.hidden[:MAX_HIDDEN_LAYERS])
    head = replace(network.head, hidden=hidden, input_dropout=min(network.head.input_dropout, MAX_DROPOUT))
    return replace(network, blocks=blocks, skips=skips, head=head, grid=clip(network.grid, 1, MAX_GRID))


def _clipped_block(block: Block) -> Block:
    return replace(
        block,
        channels=clip(block.channels, MIN_CHANNELS, MAX_CHANNELS),
        kernel=min(block.kernel, MAX_KERNEL),
        dropout=min(block.dropout, MAX_DROPOUT),
    )


def _clipped_hidden(layer: Hidden) -> Hidden:
    return replace(layer, width=clip(layer.width, MIN_HIDDEN, MAX_HIDDEN), dropout=min(layer.dropout, MAX_DROPOUT))


def _with_few_halvings(blocks: Iterable[Block]) -> tuple[Block, ...]:
    """Let the blocks after the fourth halving keep the size of their input."""
    kept: list[Block] = []
    for block in blocks:
        halvings = sum(earlier.down is not Down.none for earlier in kept)
        kept.append(block if halvings < MAX_HALVINGS else replace(block, down=Down.none))
    return tuple(kept)


def _narrowed(network: Network) -> Network:
    """Make every width a fifth smaller, down to the bounds at most."""
    blocks = tuple(replace(block, channels=max(MIN_CHANNELS, block.channels * 4 // 5)) for block in network.blocks)
    hidden = tuple(replace(layer, width=max(MIN_HIDDEN, layer.width * 4 // 5)) for layer in network.head.hidden)
    return replace(network, blocks=blocks, head=replace(network.head, hidden=hidden))


def _weights(block: Block, inputs: int) -> int:
    """Count the weights of a block's convolutions, biases aside."""
    area = block.kernel**2
    return inputs * (area + block.channels) if block.separable else inputs * area * block.channels


def _block_parameters(block: Block, inputs: int) -> int:
    biases = inputs + block.channels if block.separable else block.channels
    norm = 0 if block.norm is Norm.none else 2 * block.channels
    return _weights(block, inputs) + biases + norm + _attention_parameters(block.attention, block.channels)


def _attention_parameters(attention: Attention, channels: int) -> int:
    """Count what the helper classes hold: a 7 x 7 convolution of two maps, or two linear layers."""
    if attention is Attention.spatial:
        return 2 * 7 * 7 + 1
    if attention is Attention.channel:
        squeezed = max(channels // 8, 4)
        return 2 * channels * squeezed + squeezed + channels
    return 0


def _head_parameters(network: Network) -> int:
    layers = network.head.hidden
    sizes = (pooled_features(network), *(layer.width for layer in layers), network.signature.outputs)
    norms = sum(2 * layer.width for layer in layers if layer.layer_norm)
    return norms + sum((inputs + 1) * outputs for inputs, outputs in pairwise(sizes))
