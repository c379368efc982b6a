"""A traced graph shows what a network computes, however it is written; the graphs in graphs.py are drawn by hand."""

from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress

import pytest
import torch
from graphs import BRANCH, CHAIN, EINSUM, NO_HIDDEN_LAYER, ONE_LAYER, RESIDUAL, SHARED
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812 - the customary name, as candidates write it

from tacevo.gate.operations import is_transparent, operation
from tacevo.gate.trace import trace
from tacevo.profile import Graph


def graph_of(model: nn.Module) -> Graph:
    """Trace a network on one 3 x 8 x 8 image."""
    return trace(model, torch.ones(1, 3, 8, 8)).graph


def ops_of(model: nn.Module) -> list[str]:
    """Name a network's nodes in the order of their calls."""
    return [node.op for node in graph_of(model).nodes]


class Custom(nn.Module):
    """Any forward pass on an image, with layers or parameters of its own."""

    def __init__(self, forward: Callable[..., object], *parts: nn.Module | nn.Parameter) -> None:
        super().__init__()
        self.steps, self.parts = forward, parts
        for number, part in enumerate(parts):
            setattr(self, f"part{number}", part)

    def forward(self, x: Tensor) -> object:
        """Run the steps."""
        return self.steps(x, *self.parts)


def functional_chain(x: Tensor, a: Tensor, b: Tensor, c: Tensor, d: Tensor) -> Tensor:
    """Write every step of the chain as a function or a method."""
    x = F.max_pool2d(F.conv2d(x, a, padding=1).relu(), 2)
    x = F.conv2d(x, weight=b, padding=2).reshape(len(x), -1)
    return F.linear(F.relu(F.linear(x, c)), d)


def residual(x: Tensor, first: nn.Module, second: nn.Module, head: nn.Module) -> object:
    """Add in place, which is still an addition."""
    h = first(x)
    out = second(h)
    out += h
    return head(F.adaptive_avg_pool2d(out.relu_(), 1).flatten(1))


def branch(x: Tensor, *layers: nn.Module) -> object:
    """Loop over a list of layers and collect in a dictionary."""
    seen = {str(number): layer(x) for number, layer in enumerate(layers[:-1])}
    return layers[-1](torch.cat(list(seen.values()), dim=1).mean((2, 3)))


def shared(x: Tensor, stem: nn.Module, block: nn.Module, head: nn.Module) -> object:
    """Loop, as a recurrent block would."""
    x = stem(x)
    for _ in range(2):
        x = F.relu(block(x))
    return head(x.mean((2, 3)))


def einsum(x: Tensor, mixing: Tensor, head: nn.Module) -> object:
    """Reshape the parameter first, which is not an operation on data."""
    return head(torch.einsum("nc,ck->nk", x.mean((2, 3)), mixing.t()))


def conv(inputs: int, outputs: int, side: int = 3) -> nn.Module:
    """Make a convolution that keeps the size of the image."""
    return nn.Conv2d(inputs, outputs, side, padding=side // 2)


def weights(*shape: int) -> nn.Parameter:
    """Make a parameter."""
    return nn.Parameter(torch.ones(shape))


def layered_chain() -> nn.Module:
    """The chain, as layers in nested containers."""
    body = nn.Sequential(nn.Conv2d(3, 4, 3, padding=1), nn.ReLU(), nn.MaxPool2d(2), nn.Conv2d(4, 8, 5, padding=2))
    head = nn.Sequential(OrderedDict(flat=nn.Flatten(), a=nn.Linear(128, 6), act=nn.ReLU(), b=nn.Linear(6, 3)))
    return nn.Sequential(nn.Sequential(body, nn.Identity()), head)


@pytest.mark.parametrize(
    ("model", "graph"),
    [
        pytest.param(layered_chain(), CHAIN, id="chain"),
        pytest.param(
            Custom(functional_chain, weights(4, 3, 3, 3), weights(8, 4, 5, 5), weights(6, 128), weights(3, 6)),
            CHAIN,
            id="functional chain",
        ),
        pytest.param(Custom(residual, conv(3, 4), conv(4, 4), nn.Linear(4, 3)), RESIDUAL, id="residual"),
        pytest.param(Custom(branch, conv(3, 4, 1), conv(3, 8), nn.Linear(12, 3)), BRANCH, id="branch"),
        pytest.param(Custom(shared, conv(3, 4), conv(4, 4), nn.Linear(4, 3)), SHARED, id="shared module"),
        pytest.param(nn.Sequential(nn.Flatten(), nn.Linear(192, 3)), ONE_LAYER, id="one layer only"),
        pytest.param(Custom(einsum, weights(5, 3), nn.Linear(5, 3)), EINSUM, id="einsum"),
        pytest.param(
            nn.Sequential(
                nn.Conv2d(3, 4, 3), nn.Conv2d(4, 12, 3), nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(12, 3)
            ),
            NO_HIDDEN_LAYER,
            id="no hidden layer",
        ),
    ],
)
def test_graph_is_the_one_drawn_by_hand(model: nn.Module, graph: Graph) -> None:
    """Nodes, edges and layer properties are those of the drawing."""
    assert graph_of(model) == graph


@pytest.mark.parametrize(
    ("layer", "function"),
    [
        (nn.MaxPool2d(2), lambda x: F.max_pool2d(x, 2)),
        (nn.AvgPool2d(2), lambda x: F.avg_pool2d(x, 2)),
        (nn.AdaptiveMaxPool2d(1), lambda x: F.adaptive_max_pool2d(x, 1)),
        (nn.LPPool2d(2, 2), lambda x: F.lp_pool2d(x, 2, 2)),
        (nn.BatchNorm2d(3), lambda x: F.batch_norm(x, torch.zeros(3), torch.ones(3))),
        (nn.InstanceNorm2d(3), F.instance_norm),
        (nn.GroupNorm(1, 3), lambda x: F.group_norm(x, 1)),
        (nn.LayerNorm([3, 8, 8]), lambda x: F.layer_norm(x, [3, 8, 8])),
        (nn.RMSNorm(8), lambda x: F.rms_norm(x, [8])),
        (nn.Dropout(), lambda x: F.dropout(x, training=False)),
        (nn.Dropout2d(), lambda x: F.dropout2d(x, training=False)),
        (nn.Softmax(1), lambda x: x.softmax(1)),
        (nn.Upsample(scale_factor=2), lambda x: F.interpolate(x, scale_factor=2)),
        (nn.ZeroPad2d(1), lambda x: F.pad(x, (1, 1, 1, 1))),
        (nn.ReflectionPad2d(1), lambda x: F.pad(x, (1, 1, 1, 1), mode="reflect")),
        (nn.PixelUnshuffle(2), lambda x: F.pixel_unshuffle(x, 2)),
        (nn.GLU(3), lambda x: F.glu(x, 3)),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, nn.Module) else "",
)
def test_layer_and_its_function_spell_the_same(layer: nn.Module, function: Callable[[Tensor], Tensor]) -> None:
    """One node each, of the same type."""
    assert ops_of(layer) == ops_of(Custom(function))
    assert len(ops_of(layer)) == 1


@pytest.mark.parametrize(
    "layer",
    [
        *(nn.ReLU, nn.LeakyReLU, nn.PReLU, nn.ELU, nn.GELU, nn.SiLU),
        *(nn.Mish, nn.Sigmoid, nn.Hardtanh, nn.ReLU6, nn.Softplus, nn.LogSigmoid),
    ],
)
def test_activation_is_no_node(layer: type[nn.Module]) -> None:
    """The paper leaves simple activations out of its operation types."""
    assert ops_of(layer()) == []


def test_change_of_shape_is_no_node() -> None:
    """Data flows through any chain of reshapes, slices and casts."""

    def steps(x: Tensor) -> Tensor:
        a, b = x.permute(0, 2, 3, 1).contiguous().view(1, 64, 3).transpose(1, 2).unsqueeze(0).double().chunk(2, dim=-1)
        return (a[0, ..., :4].float() + b[0, ..., :4].float()).expand(1, 3, 4).flatten(1)

    assert ops_of(Custom(steps)) == ["add"]


def test_operator_and_method_spell_the_same() -> None:
    """Operators, reflected operators, methods and in-place forms of one operation are one type."""

    def steps(x: Tensor) -> Tensor:
        x = 1 - (2 * x + 1)
        x = x.mul(2).add_(1)
        x -= 1
        return torch.subtract(x, 1) @ x.mT

    assert ops_of(Custom(steps)) == ["mul", "add", "sub", "mul", "add", "sub", "sub", "matmul"]


def test_dropout_does_not_hide_a_skip() -> None:
    """In eval mode dropout returns its very input; the skip past it still begins before it."""

    def steps(x: Tensor, layer: nn.Module) -> object:
        h = x.mean(1, keepdim=True)
        return layer(h) + h

    assert graph_of(Custom(steps, nn.Dropout())).edges == ((0, 1), (0, 2), (1, 2))


def test_factory_starts_no_flow() -> None:
    """What takes only shape and type from its argument is not an operation on data."""
    model = Custom(lambda x: x.new_zeros(1, 3) + torch.ones_like(x).mean((2, 3)))
    assert ops_of(model) == []


def test_constant_is_no_node() -> None:
    """Coordinates are computed from sizes alone; joining them to the image is the one operation."""

    def steps(x: Tensor) -> Tensor:
        rows = torch.linspace(0, 1, x.size(2)).pow(2).view(1, 1, -1, 1).expand(1, 1, 8, 8)
        return torch.cat([x, rows], dim=1)

    assert ops_of(Custom(steps)) == ["cat"]


def test_assignment_to_a_slice_carries_data() -> None:
    """A buffer that is filled piece by piece leads from the pieces to whoever reads it."""

    def steps(x: Tensor) -> Tensor:
        buffer = torch.zeros(1, 2)
        buffer[:, 0] = x.mean((1, 2, 3))
        buffer[:, 1] = x.amax((1, 2, 3))
        return buffer.sum(1)

    graph = graph_of(Custom(steps))
    assert [node.op for node in graph.nodes] == ["mean", "amax", "sum"]
    assert graph.edges == ((0, 2), (1, 2))


def test_attention_layer_is_one_weighted_node() -> None:
    """Calls inside a layer are not nodes of their own, and its second output is tracked too."""

    def steps(x: Tensor, layer: nn.Module) -> Tensor:
        tokens = x.flatten(2)
        out, weights = layer(tokens, tokens, tokens)
        return torch.matmul(weights, out)

    graph = graph_of(Custom(steps, nn.MultiheadAttention(64, 4, batch_first=True)))
    assert [(node.op, node.weighted, node.width) for node in graph.nodes] == [
        ("multihead_attention", True, 64),
        ("matmul", False, 0),
    ]
    assert graph.edges == ((0, 1),)


def test_transformer_block_is_opened() -> None:
    """Torch's own composite blocks count as what they are made of, not as one opaque operation."""
    block = nn.Sequential(nn.Flatten(2), nn.TransformerEncoderLayer(64, 4, 32, batch_first=True))
    graph = graph_of(block)
    assert [node.op for node in graph.nodes if node.weighted] == ["multihead_attention", "linear", "linear"]
    assert graph.hidden == (32,)


def test_custom_module_with_parameters_is_its_operations() -> None:
    """A generalised-mean pooling is seen as the powers and the mean that it computes."""

    def steps(x: Tensor, power: Tensor) -> Tensor:
        return x.clamp(min=1e-6).pow(power).mean((2, 3)).pow(1 / power)

    assert ops_of(Custom(steps, weights(1))) == ["clamp", "pow", "mean", "pow"]


def test_subclass_of_a_layer_is_that_layer() -> None:
    """A class that only sets other defaults keeps its parent's operation type."""

    class Pointwise(nn.Conv2d):
        def __init__(self) -> None:
            super().__init__(3, 5, 1)

    graph = graph_of(Pointwise())
    assert [(node.op, node.width) for node in graph.nodes] == [("conv2d", 5)]


def test_reparametrised_layer_is_that_layer() -> None:
    """Weight normalisation changes where the weight comes from, not what the layer does."""
    layer = nn.utils.parametrizations.weight_norm(nn.Conv2d(3, 5, (1, 3)))
    assert graph_of(layer).channels == (5,)
    assert graph_of(layer).kernels == (2.0,)


def test_weight_made_from_the_input_is_not_weighted() -> None:
    """A dynamic convolution holds no weight of its own, so it adds neither depth nor channels."""
    graph = graph_of(Custom(lambda x: F.conv2d(x, x[:, :, :3, :3])))
    assert graph.nodes[0].op == "conv2d"
    assert not graph.nodes[0].weighted
    assert graph.channels == ()


def test_transposed_convolution_counts_output_channels() -> None:
    """Its weight is stored the other way round."""
    graph = graph_of(nn.ConvTranspose2d(3, 7, 2, stride=2))
    assert (graph.nodes[0].op, graph.channels, graph.kernels) == ("conv_transpose2d", (7,), (2.0,))


def test_last_linear_called_is_no_hidden_layer() -> None:
    """The output layer is the one called last, in whatever order layers were made."""

    def steps(x: Tensor, first: nn.Module, last: nn.Module) -> object:
        return first(last(x.flatten(1)))

    assert graph_of(Custom(steps, nn.Linear(9, 3), nn.Linear(192, 9))).hidden == (9,)


def test_tracing_leaves_no_hook_behind() -> None:
    """A network that fails in the middle of a layer does not change how the next one is seen."""
    with pytest.raises(RuntimeError, match="shapes cannot be multiplied"):
        graph_of(nn.Linear(5, 3))
    assert graph_of(nn.Sequential(nn.Flatten(), nn.Linear(192, 3))) == ONE_LAYER


@pytest.mark.parametrize(
    "bad",
    [
        pytest.param(nn.Linear(5, 3), id="layer"),
        pytest.param(nn.Sequential(nn.ReLU(), nn.Linear(5, 3)), id="layer in a container"),
        pytest.param(nn.MultiheadAttention(5, 1), id="layer that checks its arguments"),
        pytest.param(nn.LSTM(5, 3), id="recurrent layer"),
    ],
)
def test_caught_error_does_not_blind_the_tracer(bad: nn.Module) -> None:
    """A network that catches the error of a layer and continues is recorded on; a failed call is not a node."""

    def steps(x: Tensor, first: nn.Module, last: nn.Module) -> object:
        for _ in range(2):
            with suppress(RuntimeError, TypeError):
                first(x.flatten(1))
        return last(x.flatten(1))

    assert graph_of(Custom(steps, bad, nn.Linear(192, 3))) == ONE_LAYER


def test_error_of_a_hook_does_not_blind_the_tracer() -> None:
    """A layer whose own hook raises before its forward pass is left all the same."""

    def refuse(layer: nn.Module, args: object) -> None:
        raise RuntimeError("not today")

    def steps(x: Tensor, first: nn.Module, last: nn.Module) -> object:
        with suppress(RuntimeError):
            first(x.flatten(1))
        return last(x.flatten(1))

    bad = nn.Linear(192, 3)
    bad.register_forward_pre_hook(refuse)
    assert graph_of(Custom(steps, bad, nn.Linear(192, 3))) == ONE_LAYER


def test_operation_knows_class_names() -> None:
    """Names of layer classes become names of functions."""
    assert operation("AdaptiveAvgPool2d") == "adaptive_avg_pool2d"
    assert operation("_BatchNorm") == "batch_norm"
    assert operation("max_pool2d_with_indices") == "max_pool2d"
    assert is_transparent(operation("LeakyReLU"))
    assert not is_transparent(operation("LayerNorm"))
