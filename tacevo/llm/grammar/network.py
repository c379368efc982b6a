"""The networks of the grammar: convolutional ones, as frozen records.

The value of an enum member that stands for a layer is that layer as PyTorch code writes it, so that writing and
reading share one table.
"""

from dataclasses import dataclass
from enum import StrEnum


class Activation(StrEnum):
    """A non-linearity, as code."""

    relu = "nn.ReLU()"
    leaky_relu = "nn.LeakyReLU(0.01)"
    gelu = "nn.GELU()"
    silu = "nn.SiLU()"
    elu = "nn.ELU()"


class Norm(StrEnum):
    """The normalisation of a convolutional block's channels, as the name of the layer."""

    none = ""
    batch = "nn.BatchNorm2d"
    group = "nn.GroupNorm"


class Down(StrEnum):
    """The layer by which a block halves height and width: a pooling layer as code, or a convolution of stride 2."""

    none = ""
    max = "nn.MaxPool2d(2)"
    average = "nn.AvgPool2d(2)"
    stride = "stride"


class Attention(StrEnum):
    """A module that weights positions or channels, as the name of its class."""

    none = ""
    spatial = "SpatialAttention"
    channel = "ChannelAttention"


class Pooling(StrEnum):
    """The layer that brings the feature map to a fixed grid before the head."""

    average = "average"
    max = "max"
    both = "both"


class Output(StrEnum):
    """The last layer of the head, which bounds the outputs."""

    free = ""
    sigmoid = "nn.Sigmoid()"
    tanh = "nn.Tanh()"
    hardtanh = "nn.Hardtanh()"
    softmax = "nn.Softmax(dim=1)"


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """One convolutional block: convolution, norm, activation, attention, dropout, pooling, in this order."""

    channels: int
    #: Side of the square kernel in pixels, odd.
    kernel: int = 3
    #: A depthwise convolution followed by a pointwise one, in place of a full convolution.
    separable: bool = False
    norm: Norm = Norm.none
    activation: Activation = Activation.relu
    attention: Attention = Attention.none
    #: Probability of dropping a whole channel; 0 means no such layer.
    dropout: float = 0.0
    down: Down = Down.none

    def __post_init__(self) -> None:
        if self.kernel % 2 == 0:
            raise ValueError(f"a block's kernel must be odd; got {self.kernel}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Hidden:
    """One hidden layer of the head: linear, norm, activation, dropout, in this order."""

    width: int
    #: A LayerNorm between the linear layer and the activation.
    layer_norm: bool = False
    activation: Activation = Activation.relu
    #: Probability of dropping a feature; 0 means no such layer.
    dropout: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Head:
    """The head, which turns the pooled features into the outputs."""

    #: The hidden layers, from the features to the outputs.
    hidden: tuple[Hidden, ...]
    #: Probability of dropping a pooled feature, ahead of the first linear layer; 0 means no such layer.
    input_dropout: float = 0.0
    output: Output = Output.free
    #: Whether the head is a class of its own.
    own_module: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Signature:
    """The names and defaults that a child always takes over from its parent."""

    class_name: str
    in_channels: int
    output_argument: str
    outputs: int
    #: Attribute that holds the head, e.g. `regressor`.
    head_name: str
    #: One line without quotes and backslashes; may be empty.
    docstring: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Network:
    """A network of the grammar; `parsing.parse` and `rendering.render` are inverse to each other on it."""

    signature: Signature
    #: The trunk, `conv1` first.
    blocks: tuple[Block, ...]
    #: Residual connections (source, target), increasing: the output of block `source` (counted from 1; 0 is the
    #: image) is added to the output of block `target`.
    skips: tuple[tuple[int, int], ...] = ()
    #: Stands right before the adaptive pooling.
    attention: Attention = Attention.none
    pooling: Pooling = Pooling.average
    #: Side of the pooled map, in cells.
    grid: int = 4
    head: Head
    #: Whether the blocks are instances of one custom module.
    block_module: bool = False

    def __post_init__(self) -> None:
        if not self.blocks:
            raise ValueError("a network needs at least one block; got none")
        if any(not 0 <= source < target <= len(self.blocks) for source, target in self.skips):
            raise ValueError(f"each skip must go forward within {len(self.blocks)} blocks; got {self.skips}")
        if list(self.skips) != sorted(set(self.skips)):
            raise ValueError(f"skips must be distinct and in order; got {self.skips}")


def pooled_features(network: Network) -> int:
    """Count the features that the head receives."""
    maps = 2 if network.pooling is Pooling.both else 1
    return maps * network.blocks[-1].channels * network.grid**2


def widths(network: Network) -> tuple[int, ...]:
    """List the channels before the trunk and after each of its blocks; shape (len(blocks) + 1,)."""
    return (network.signature.in_channels, *(block.channels for block in network.blocks))


def shrinks_between(network: Network, source: int, target: int) -> bool:
    """Return whether the map loses height and width between the outputs of two blocks (0 is the image)."""
    return any(block.down is not Down.none for block in network.blocks[source:target])
