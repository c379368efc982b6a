"""The renderer from a network of the grammar to PyTorch code as a person would write it."""

from math import gcd

from tacevo.llm.grammar.network import Attention, Block, Down, Head, Network, Norm, Pooling, shrinks_between, widths

SPATIAL_ATTENTION = '''\
class SpatialAttention(nn.Module):
    """Weights the positions of a feature map by the mean and the maximum over its channels."""

    def __init__(self, kernel_size=7):
        super().__init__()
        self.conv = nn.Conv2d(2, 1, kernel_size=kernel_size, padding=kernel_size // 2)

    def forward(self, x):
        summary = torch.cat([x.mean(dim=1, keepdim=True), x.amax(dim=1, keepdim=True)], dim=1)
        return x * torch.sigmoid(self.conv(summary))'''

CHANNEL_ATTENTION = '''\
class ChannelAttention(nn.Module):
    """Weights the channels of a feature map by their means over all positions."""

    def __init__(self, channels, reduction=8):
        super().__init__()
        squeezed = max(channels // reduction, 4)
        self.gate = nn.Sequential(
            nn.Linear(channels, squeezed),
            nn.ReLU(),
            nn.Linear(squeezed, channels),
            nn.Sigmoid(),
        )

    def forward(self, x):
        weights = self.gate(x.mean(dim=(2, 3)))
        return x * weights[:, :, None, None]'''

CONV_BLOCK = '''\
class ConvBlock(nn.Module):
    """A convolution, depthwise separable if asked, and the layers that follow it."""

    def __init__(self, in_channels, out_channels, kernel_size, layers, stride=1, separable=False):
        super().__init__()
        padding = kernel_size // 2
        if separable:
            self.conv = nn.Sequential(
                nn.Conv2d(in_channels, in_channels, kernel_size, stride, padding, groups=in_channels),
                nn.Conv2d(in_channels, out_channels, kernel_size=1),
            )
        else:
            self.conv = nn.Conv2d(in_channels, out_channels, kernel_size, stride, padding)
        self.layers = nn.Sequential(*layers)

    def forward(self, x):
        return self.layers(self.conv(x))'''

_INDENT = "    "

_LONGEST_LINE = 100


def render(network: Network) -> str:
    """Write a network as source text: the helper classes it needs, then its own class.

    The text uses the names `torch`, `nn` and `F` without importing them.
    """
    parts = []
    attentions = {network.attention, *(block.attention for block in network.blocks)}
    if Attention.spatial in attentions:
        parts.append(SPATIAL_ATTENTION)
    if Attention.channel in attentions:
        parts.append(CHANNEL_ATTENTION)
    if network.block_module:
        parts.append(CONV_BLOCK)
    if network.head.own_module:
        parts.append(_head_class(network))
    parts.append(_network_class(network))
    return "\n\n\n".join(parts) + "\n"


def _network_class(network: Network) -> str:
    """Write the class that the task asks for."""
    signature = network.signature
    arguments = f"in_channels={signature.in_channels}, {signature.output_argument}={signature.outputs}"
    return _class(signature.class_name, signature.docstring, arguments, _attributes(network), _forward(network))


def _class(name: str, docstring: str, arguments: str, constructor: list[str], forward: list[str]) -> str:
    """Write a module with the statements of its two methods."""
    lines = [f"class {name}(nn.Module):"]
    if docstring:
        lines += [f'{_INDENT}"""{docstring}"""', ""]
    lines += [f"{_INDENT}def __init__(self, {arguments}):", *_indented(["super().__init__()", *constructor])]
    return "\n".join([*lines, "", f"{_INDENT}def forward(self, x):", *_indented(forward)])


def _attributes(network: Network) -> list[str]:
    """Write the statements of the constructor."""
    lines = []
    inputs = "in_channels"
    for number, block in enumerate(network.blocks, start=1):
        lines += _conv_block(number, block, inputs) if network.block_module else _sequential(number, block, inputs)
        inputs = str(block.channels)
    for source, target in network.skips:
        if _needs_projection(network, source, target):
            before, after = "in_channels" if source == 0 else widths(network)[source], widths(network)[target]
            lines.append(f"self.skip{source}_to_{target} = nn.Conv2d({before}, {after}, kernel_size=1)")
    if network.attention is not Attention.none:
        lines.append(f"self.attention = {_attention(network.attention, network.blocks[-1].channels)}")
    first = "Max" if network.pooling is Pooling.max else "Avg"
    lines.append(f"self.adaptive_pool = nn.Adaptive{first}Pool2d(({network.grid}, {network.grid}))")
    if network.pooling is Pooling.both:
        lines.append(f"self.adaptive_max_pool = nn.AdaptiveMaxPool2d(({network.grid}, {network.grid}))")
    return lines + _head(network)


def _sequential(number: int, block: Block, inputs: str) -> list[str]:
    """Write a block as a Sequential of plain layers."""
    stride = ", stride=2" if block.down is Down.stride else ""
    padding = f", padding={block.kernel // 2}" if block.kernel > 1 else ""
    shape = f"kernel_size={block.kernel}{stride}{padding}"
    if block.separable:
        convolutions = [
            f"nn.Conv2d({inputs}, {inputs}, {shape}, groups={inputs})",
            f"nn.Conv2d({inputs}, {block.channels}, kernel_size=1)",
        ]
    else:
        convolutions = [f"nn.Conv2d({inputs}, {block.channels}, {shape})"]
    return _call(f"self.conv{number} = nn.Sequential", convolutions + _layers_after_convolution(block))


def _conv_block(number: int, block: Block, inputs: str) -> list[str]:
    """Write a block as an instance of the custom module."""
    layers = ", ".join(_layers_after_convolution(block))
    arguments = f"{inputs}, {block.channels}, kernel_size={block.kernel}, layers=[{layers}]"
    if block.down is Down.stride:
        arguments += ", stride=2"
    if block.separable:
        arguments += ", separable=True"
    line = f"self.conv{number} = ConvBlock({arguments})"
    if len(line) <= _LONGEST_LINE:
        return [line]
    return [f"self.conv{number} = ConvBlock(", _INDENT + arguments, ")"]


def _layers_after_convolution(block: Block) -> list[str]:
    layers = []
    if block.norm is Norm.batch:
        layers.append(f"{block.norm}({block.channels})")
    if block.norm is Norm.group:
        layers.append(f"{block.norm}({gcd(8, block.channels)}, {block.channels})")
    layers.append(block.activation.value)
    if block.attention is not Attention.none:
        layers.append(_attention(block.attention, block.channels))
    if block.dropout:
        layers.append(f"nn.Dropout2d({block.dropout})")
    if block.down in {Down.max, Down.average}:
        layers.append(block.down.value)
    return layers


def _attention(attention: Attention, channels: int) -> str:
    return f"{attention}({channels})" if attention is Attention.channel else f"{attention}()"


def _head(network: Network) -> list[str]:
    """Write the statement that makes the head."""
    signature = network.signature
    if network.head.own_module:
        return [f"self.{signature.head_name} = Head({_features(network)}, {signature.output_argument})"]
    return _call(f"self.{signature.head_name} = nn.Sequential", _head_layers(network, _features(network)))


def _head_class(network: Network) -> str:
    """Write the head as a class of its own."""
    arguments = f"in_features, {network.signature.output_argument}"
    layers = _call("self.layers = nn.Sequential", _head_layers(network, "in_features"))
    return _class("Head", "Turns the pooled features into the outputs.", arguments, layers, ["return self.layers(x)"])


def _head_layers(network: Network, inputs: str) -> list[str]:
    head: Head = network.head
    layers = ["nn.Flatten()"]
    if head.input_dropout:
        layers.append(f"nn.Dropout({head.input_dropout})")
    for hidden in head.hidden:
        layers.append(f"nn.Linear({inputs}, {hidden.width})")
        if hidden.layer_norm:
            layers.append(f"nn.LayerNorm({hidden.width})")
        layers.append(hidden.activation.value)
        if hidden.dropout:
            layers.append(f"nn.Dropout({hidden.dropout})")
        inputs = str(hidden.width)
    layers.append(f"nn.Linear({inputs}, {network.signature.output_argument})")
    if head.output:
        layers.append(head.output.value)
    return layers


def _features(network: Network) -> str:
    """Write the number of pooled features as the product that a reader recognises."""
    maps = "2 * " if network.pooling is Pooling.both else ""
    return f"{maps}{network.blocks[-1].channels} * {network.grid} * {network.grid}"


def _forward(network: Network) -> list[str]:
    """Write the statements of `forward`."""
    sources = {source for source, _ in network.skips}
    lines = ["skip0 = x"] if 0 in sources else []
    for number in range(1, len(network.blocks) + 1):
        lines.append(f"x = self.conv{number}(x)")
        lines += [_addition(network, source, target) for source, target in network.skips if target == number]
        if number in sources:
            lines.append(f"skip{number} = x")
    if network.attention is not Attention.none:
        lines.append("x = self.attention(x)")
    if network.pooling is Pooling.both:
        lines.append("x = torch.cat([self.adaptive_pool(x), self.adaptive_max_pool(x)], dim=1)")
    else:
        lines.append("x = self.adaptive_pool(x)")
    return [*lines, f"return self.{network.signature.head_name}(x)"]


def _addition(network: Network, source: int, target: int) -> str:
    """Write the end of a residual connection, resized and projected only where the shapes differ."""
    skipped = f"skip{source}"
    if shrinks_between(network, source, target):
        skipped = f"F.adaptive_avg_pool2d({skipped}, x.shape[-2:])"
    if _needs_projection(network, source, target):
        skipped = f"self.skip{source}_to_{target}({skipped})"
    return f"x = x + {skipped}"


def _needs_projection(network: Network, source: int, target: int) -> bool:
    # The number of image channels is an argument, so it may differ from the default that the network knows.
    return source == 0 or widths(network)[source] != widths(network)[target]


def _call(opening: str, arguments: list[str]) -> list[str]:
    """Write a call with one argument a line."""
    return [f"{opening}(", *(f"{_INDENT}{argument}," for argument in arguments), ")"]


def _indented(lines: list[str]) -> list[str]:
    """Indent the body of a method."""
    return [2 * _INDENT + line for line in lines]
