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

#: The steps of a network: an image and its one layer in, anything out.
Forward = Callable[[Tensor, nn.Module], object]


def graph_of(model: nn.Module) -> Graph:
    """Trace a network on one 3 x 8 x 8 image."""
    return trace(model, torch.ones(1, 3, 8, 8)).graph


def ops_of(model: nn.Module) -> list[str]:
    """Name a network's nodes in the order of their calls."""
    return [node.op for node in graph_of(model).nodes]


class FunctionalChain(nn.Module):
    """The chain without a single layer object."""

    def __init__(self) -> None:
        super().__init__()
        shapes = {"a": (4, 3, 3, 3), "b": (8, 4, 5, 5), "c": (6, 128), "d": (3, 6)}
        self.weights = nn.ParameterDict({name: nn.Parameter(torch.ones(shape)) for name, shape in shapes.items()})

    def forward(self, x: Tensor) -> Tensor:
        """Write every step as a function or a method."""
        x = F.conv2d(x, self.weights["a"], padding=1).relu()
        x = F.max_pool2d(x, 2)
        x = F.conv2d(x, weight=self.weights["b"], padding=2).reshape(len(x), -1)
        return F.linear(F.relu(F.linear(x, self.weights["c"])), self.weights["d"])


class Residual(nn.Module):
    """A skip over the second convolution."""

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Conv2d(3, 4, 3, padding=1)
        self.second = nn.Conv2d(4, 4, 3, padding=1)
        self.head = nn.Linear(4, 3)

    def forward(self, x: Tensor) -> Tensor:
        """Add in place, which is still an addition."""
        h = self.first(x)
        out = self.second(h)
        out += h
        out = F.adaptive_avg_pool2d(out.relu_(), 1)
        return self.head(out.flatten(1))  # type: ignore[no-any-return]


class Branch(nn.Module):
    """Two convolutions of the same image."""

    def __init__(self) -> None:
        super().__init__()
        self.branches = nn.ModuleList([nn.Conv2d(3, 4, 1), nn.Conv2d(3, 8, 3, padding=1)])
        self.head = nn.Linear(12, 3)

    def forward(self, x: Tensor) -> Tensor:
        """Loop over a list of layers and collect in a dictionary."""
        found = {str(i): branch(x) for i, branch in enumerate(self.branches)}
        return self.head(torch.cat(list(found.values()), dim=1).mean((2, 3)))  # type: ignore[no-any-return]


class Shared(nn.Module):
    """One layer called twice."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = nn.Conv2d(3, 4, 3, padding=1)
        self.block = nn.Conv2d(4, 4, 3, padding=1)
        self.head = nn.Linear(4, 3)

    def forward(self, x: Tensor) -> Tensor:
        """Loop, as a recurrent block would."""
        x = self.stem(x)
        for _ in range(2):
            x = F.relu(self.block(x))
        return self.head(x.mean((2, 3)))  # type: ignore[no-any-return]


class Einsum(nn.Module):
    """A parameter used by einsum, after a change of shape."""

    def __init__(self) -> None:
        super().__init__()
        self.mixing = nn.Parameter(torch.ones(5, 3))
        self.head = nn.Linear(5, 3)

    def forward(self, x: Tensor) -> Tensor:
        """Reshape the parameter first, which is not an operation on data."""
        x = torch.einsum("nc,ck->nk", x.mean((2, 3)), self.mixing.t())
        return self.head(x)  # type: ignore[no-any-return]


class Custom(nn.Module):
    """Any forward pass on an image, with at most one layer of its own."""

    def __init__(self, forward: Forward, layer: nn.Module | None = None) -> None:
        super().__init__()
        self.layer = layer or nn.Identity()
        self.steps = forward

    def forward(self, x: Tensor) -> object:
        """Run the steps."""
        return self.steps(x, self.layer)


def layered_chain() -> nn.Module:
    """The chain, as layers in nested containers."""
    body = nn.Sequential(nn.Conv2d(3, 4, 3, padding=1), nn.ReLU(), nn.MaxPool2d(2), nn.Conv2d(4, 8, 5, padding=2))
    head = nn.Sequential(OrderedDict(flat=nn.Flatten(), a=nn.Linear(128, 6), act=nn.ReLU(), b=nn.Linear(6, 3)))
    return nn.Sequential(nn.Sequential(body, nn.Identity()), head)


@pytest.mark.parametrize(
    ("model", "graph"),
    [
        pytest.param(layered_chain(), CHAIN, id="chain"),
        pytest.param(FunctionalChain(), CHAIN, id="functional chain"),
        pytest.param(Residual(), RESIDUAL, id="residual"),
        pytest.param(Branch(), BRANCH, id="branch"),
        pytest.param(Shared(), SHARED, id="shared module"),
        pytest.param(nn.Sequential(nn.Flatten(), nn.Linear(192, 3)), ONE_LAYER, id="one layer only"),
        pytest.param(Einsum(), EINSUM, id="einsum"),
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
    assert ops_of(layer) == ops_of(Custom(lambda x, _: function(x)))
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

    def steps(x: Tensor, layer: nn.Module) -> Tensor:
        a, b = x.permute(0, 2, 3, 1).contiguous().view(1, 64, 3).transpose(1, 2).unsqueeze(0).double().chunk(2, dim=-1)
        return (a[0, ..., :4].float() + b[0, ..., :4].float()).expand(1, 3, 4).flatten(1)

    assert ops_of(Custom(steps)) == ["add"]


def test_operator_and_method_spell_the_same() -> None:
    """Operators, reflected operators, methods and in-place forms of one operation are one type."""

    def steps(x: Tensor, layer: nn.Module) -> Tensor:
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
    model = Custom(lambda x, _: x.new_zeros(1, 3) + torch.ones_like(x).mean((2, 3)))
    assert ops_of(model) == []


def test_constant_is_no_node() -> None:
    """Coordinates are computed from sizes alone; joining them to the image is the one operation."""

    def steps(x: Tensor, layer: nn.Module) -> Tensor:
        rows = torch.linspace(0, 1, x.size(2)).pow(2).view(1, 1, -1, 1).expand(1, 1, 8, 8)
        return torch.cat([x, rows], dim=1)

    assert ops_of(Custom(steps)) == ["cat"]


def test_assignment_to_a_slice_carries_data() -> None:
    """A buffer that is filled piece by piece leads from the pieces to whoever reads it."""

    def steps(x: Tensor, layer: nn.Module) -> Tensor:
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

    def steps(x: Tensor, layer: nn.Module) -> Tensor:
        power = layer.get_parameter("weight")
        return x.clamp(min=1e-6).pow(power).mean((2, 3)).pow(1 / power)

    assert ops_of(Custom(steps, nn.PReLU())) == ["clamp", "pow", "mean", "pow"]


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
    graph = graph_of(Custom(lambda x, _: F.conv2d(x, x[:, :, :3, :3])))
    assert graph.nodes[0].op == "conv2d"
    assert not graph.nodes[0].weighted
    assert graph.channels == ()


def test_transposed_convolution_counts_output_channels() -> None:
    """Its weight is stored the other way round."""
    graph = graph_of(nn.ConvTranspose2d(3, 7, 2, stride=2))
    assert (graph.nodes[0].op, graph.channels, graph.kernels) == ("conv_transpose2d", (7,), (2.0,))


def test_last_linear_called_is_no_hidden_layer() -> None:
    """The output layer is the one called last, in whatever order layers were made."""

    def steps(x: Tensor, layer: nn.Module) -> object:
        assert isinstance(layer, nn.ModuleList)
        return layer[0](layer[1](x.flatten(1)))

    layers = nn.ModuleList([nn.Linear(9, 3), nn.Linear(192, 9)])
    assert graph_of(Custom(steps, layers)).hidden == (9,)


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

    def steps(x: Tensor, layer: nn.Module) -> object:
        assert isinstance(layer, nn.ModuleList)
        for _ in range(2):
            with suppress(RuntimeError, TypeError):
                layer[0](x.flatten(1))
        return layer[1](x.flatten(1))

    assert graph_of(Custom(steps, nn.ModuleList([bad, nn.Linear(192, 3)]))) == ONE_LAYER


def test_error_of_a_hook_does_not_blind_the_tracer() -> None:
    """A layer whose own hook raises before its forward pass is left all the same."""

    def refuse(layer: nn.Module, args: object) -> None:
        raise RuntimeError("not today")

    def steps(x: Tensor, layer: nn.Module) -> object:
        assert isinstance(layer, nn.ModuleList)
        with suppress(RuntimeError):
            layer[0](x.flatten(1))
        return layer[1](x.flatten(1))

    bad = nn.Linear(192, 3)
    bad.register_forward_pre_hook(refuse)
    assert graph_of(Custom(steps, nn.ModuleList([bad, nn.Linear(192, 3)]))) == ONE_LAYER


def test_operation_knows_class_names() -> None:
    """Names of layer classes become names of functions."""
    assert operation("AdaptiveAvgPool2d") == "adaptive_avg_pool2d"
    assert operation("_BatchNorm") == "batch_norm"
    assert operation("max_pool2d_with_indices") == "max_pool2d"
    assert is_transparent(operation("LeakyReLU"))
    assert not is_transparent(operation("LayerNorm"))
