"""The steps of a traced pass hold what the graph leaves out, alike for a layer and its function."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812 - the customary name, as candidates write it

from tacevo.gate.operations import activation
from tacevo.gate.trace import trace
from tacevo.profile import MOST_OPERANDS, MOST_STEPS, Step


class Function(nn.Module):
    """A network that is one function of the image."""

    def __init__(self, function: Callable[[Tensor], Tensor]) -> None:
        super().__init__()
        self.function = function

    def forward(self, x: Tensor) -> Tensor:
        """Call it."""
        return self.function(x)


def steps_of(model: nn.Module | Callable[[Tensor], Tensor]) -> tuple[Step, ...]:
    """Trace a network, or a function, on one image of 4 channels and 8 x 8 pixels."""
    return trace(model if isinstance(model, nn.Module) else Function(model), torch.ones(1, 4, 8, 8)).steps


@pytest.mark.parametrize(
    ("layer", "function"),
    [
        (nn.Conv2d(4, 6, 3, stride=2), lambda x: F.conv2d(x, torch.ones(6, 4, 3, 3), None, 2)),
        (nn.Conv2d(4, 6, 3, stride=2), lambda x: F.conv2d(x, torch.ones(6, 4, 3, 3), stride=(2, 2))),
        (nn.Conv2d(4, 4, 3, groups=4), lambda x: F.conv2d(x, torch.ones(4, 1, 3, 3), None, 1, 0, 1, 4)),
        (nn.Conv2d(4, 4, 3, groups=2), lambda x: F.conv2d(x, torch.ones(4, 2, 3, 3), groups=2)),
        (nn.ConvTranspose2d(4, 2, (1, 2), 2), lambda x: F.conv_transpose2d(x, torch.ones(4, 2, 1, 2), None, 2)),
        (nn.Dropout(0.3), lambda x: F.dropout(x, 0.3, training=False)),
        (nn.Dropout2d(0.2), lambda x: F.dropout2d(x, p=0.2, training=False)),
        (nn.Dropout(), lambda x: F.dropout(x, training=False)),
        (nn.LeakyReLU(), F.leaky_relu),
        (nn.SiLU(inplace=True), F.silu),
        (nn.Hardsigmoid(), F.hardsigmoid),
        (nn.ReLU6(), F.relu6),
    ],
)
def test_layer_and_its_function_are_one_step(layer: nn.Module, function: Callable[[Tensor], Tensor]) -> None:
    """With equal settings; only whether a parameter is behind it differs, since the functions here were given none."""
    (ours,), (theirs,) = steps_of(layer), steps_of(function)
    names = ("op", "sources", "operands", "shape", "kernel", "stride", "groups", "rate")
    assert [getattr(ours, name) for name in names] == [getattr(theirs, name) for name in names]


def test_settings_are_those_of_the_layer() -> None:
    """A strided, grouped convolution, in full."""
    assert steps_of(nn.Conv2d(4, 6, (3, 5), stride=2, padding=(1, 2), groups=2)) == (
        Step(
            op="conv2d",
            weighted=True,
            sources=((),),
            operands=((1, 4, 8, 8),),
            shape=(1, 6, 4, 4),
            kernel=(3, 5),
            stride=(2, 2),
            groups=2,
        ),
    )


def test_operands_are_told_apart() -> None:
    """The two sides of a product come from their own steps, through any change of shape."""
    first, gate, product = steps_of(lambda x: x.tanh() * x.mean((2, 3))[:, :, None, None])
    assert (first.op, gate.op, product.op) == ("tanh", "mean", "mul")
    assert product.sources == ((0,), (1,))
    assert product.operands == ((1, 4, 8, 8), (1, 4, 1, 1))


def test_output_names_its_steps() -> None:
    """What is computed after it, or beside it, is not behind it."""

    def forward(x: Tensor) -> Tensor:
        out = x.relu()
        x.sigmoid()
        return out.flatten(1)

    assert trace(Function(forward), torch.ones(1, 4, 8, 8)).ends == (0,)


def test_network_that_returns_its_input_ends_nowhere() -> None:
    """The image is not a step."""
    assert trace(nn.Identity(), torch.ones(1, 4, 8, 8)).ends == ()


def test_every_activation_of_torch_has_one_name() -> None:
    """The class name does not show where the words of the function's name begin."""
    for layer, name in (
        (nn.LeakyReLU, "leaky_relu"),
        (nn.PReLU, "prelu"),
        (nn.GELU, "gelu"),
        (nn.LogSigmoid, "log_sigmoid"),
    ):
        (step,) = steps_of(layer())
        assert step.op == name
    assert activation("conv2d") is None


def test_long_pass_is_recorded_up_to_the_limit() -> None:
    """A network of many cheap calls gets its verdict all the same."""

    def forward(x: Tensor) -> Tensor:
        for _ in range(MOST_STEPS + 10):
            x = x.relu()
        return x

    assert len(steps_of(forward)) == MOST_STEPS


def test_step_of_many_operands_keeps_the_first() -> None:
    """Motifs look at two."""
    (step,) = steps_of(lambda x: torch.cat([x] * (MOST_OPERANDS + 1)))
    assert len(step.operands) == len(step.sources) == MOST_OPERANDS
