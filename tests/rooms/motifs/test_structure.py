"""How a network is built is read off its steps: blocks, head, norms, dropouts and shortcuts, however it is written."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from grammar_strategies import SIGNATURE, networks
from hypothesis import given
from motif_cases import CLASSES, anatomy_of, baseline, built
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812 - the customary name, as candidates write it

from analysis.motifs.structure import Anatomy
from tacevo.llm.grammar.bounds import fit
from tacevo.llm.grammar.network import Attention, Down, Network, Norm
from tacevo.llm.grammar.rendering import render

pytestmark = pytest.mark.room("grammar")

Steps = Callable[["Layers", Tensor], Tensor]


class Layers(nn.Module):
    """A stem of 8 channels, steps that a test chooses, and a linear layer; with layers that the steps may use."""

    def __init__(self, steps: Steps) -> None:
        super().__init__()
        self.stem = nn.Conv2d(3, 8, 3, padding=1)
        self.same = nn.Conv2d(8, 8, 3, padding=1)
        self.other = nn.Conv2d(8, 8, 5, padding=2)
        self.point = nn.Conv2d(8, 8, 1)
        self.depthwise = nn.Conv2d(8, 8, 3, padding=1, groups=8)
        self.wide = nn.Conv2d(8, 16, 1)
        self.narrow = nn.Conv2d(16, 8, 1)
        self.hidden = nn.Linear(8, 8)
        self.last = nn.Linear(8, 3)
        self.steps = steps

    def forward(self, x: Tensor) -> Tensor:
        """Run stem, steps, mean over positions and last layer."""
        x = self.steps(self, self.stem(x))
        return self.last(x.mean((2, 3)) if x.dim() == 4 else x)  # type: ignore[no-any-return]


def read(steps: Steps) -> Anatomy:
    """Read a network of these steps."""
    return anatomy_of(Layers(steps))


@pytest.mark.parametrize("task", CLASSES)
def test_baseline_is_read_by_hand(task: str) -> None:
    """Three blocks of 32, 64 and 128 channels with max pooling, a hidden layer of 512 with dropout."""
    assert baseline(task) == Anatomy(
        has_spatial_attention=False,
        channels=(32, 64, 128),
        strided=0,
        blocks=3,
        pointwise=0,
        max_pools=3,
        hidden=512,
        head_depth=2,
        activations=frozenset({"relu"}),
        residuals=0,
        norms=frozenset(),
        has_dropout=True,
    )


@pytest.mark.parametrize(
    "steps",
    [
        pytest.param(lambda net, x: x + net.same(x), id="plain"),
        pytest.param(lambda net, x: net.same(x).relu().add_(x), id="in place"),
        pytest.param(lambda net, x: net.point(x) + net.same(x), id="projected"),
        pytest.param(lambda net, x: net.narrow(net.wide(x).relu()) + x, id="bottleneck"),
        pytest.param(lambda net, x: torch.add(F.avg_pool2d(x, 2), net.same(F.max_pool2d(x, 2))), id="resized"),
        pytest.param(lambda net, x: net.point(x) + net.same(net.other(x)), id="past two"),
        pytest.param(lambda net, x: (pooled := x.mean((2, 3))) + net.hidden(pooled).relu(), id="in the head"),
    ],
)
def test_shortcut_is_found(steps: Steps) -> None:
    """An addition one side of which goes past layers of the other."""
    assert read(steps).residuals == 1


@pytest.mark.parametrize(
    "steps",
    [
        pytest.param(lambda net, x: x + x, id="twice the same"),
        pytest.param(lambda net, x: net.same(x) + net.other(x), id="parallel branches"),
        pytest.param(lambda net, x: x.relu() + x.tanh(), id="no layer at all"),
        pytest.param(lambda net, x: x + net.stem.bias[:, None, None], id="a parameter"),
        pytest.param(lambda net, x: torch.cat([x, net.same(x)], 1)[:, :8], id="joined, not added"),
        pytest.param(lambda net, x: (x + net.same(x), x)[1], id="added and dropped"),
        pytest.param(lambda net, x: net.same(x) - x, id="a difference"),
    ],
)
def test_no_shortcut_is_made_up(steps: Steps) -> None:
    """Other sums, and sums that nothing comes of, are none."""
    assert read(steps).residuals == 0


def test_shortcut_is_no_part_of_the_trunk() -> None:
    """Its projection is not a 1x1 convolution of the network, nor its pooling a pooling."""
    anatomy = read(lambda net, x: net.point(F.max_pool2d(x, 2)) + net.same(F.max_pool2d(x, 2)))
    assert (anatomy.pointwise, anatomy.max_pools, anatomy.blocks) == (0, 1, 2)


def test_separable_convolution_is_one_block() -> None:
    """Its width is that of its second half, which is not a 1x1 convolution of its own."""
    anatomy = read(lambda net, x: net.narrow(net.wide(net.depthwise(x).relu()).relu()))
    assert (anatomy.channels, anatomy.blocks, anatomy.pointwise) == ((8, 16), 2, 1)


def test_blocks_are_counted_along_a_path() -> None:
    """Two branches side by side are one block deep."""
    anatomy = read(lambda net, x: net.same(x) + net.other(x))
    assert (anatomy.blocks, len(anatomy.channels)) == (2, 3)


def test_stride_and_pooling_are_told_apart() -> None:
    """One step of each kind."""
    strided = nn.Conv2d(8, 8, 3, stride=(1, 2))
    anatomy = read(lambda net, x: F.avg_pool2d(F.max_pool2d(F.conv2d(x, strided.weight, stride=(1, 2)), 2), 2))
    assert (anatomy.strided, anatomy.max_pools) == (1, 1)


def test_unused_layers_are_no_part() -> None:
    """The class above has many; one whose result is thrown away is none either."""
    anatomy = read(lambda net, x: (net.same(x), x)[1])
    assert (len(anatomy.channels), anatomy.head_depth) == (1, 1)


def test_norms_have_a_place() -> None:
    """In the blocks they see a map, in the head a vector."""
    blocks = nn.Sequential(nn.BatchNorm2d(8), nn.GroupNorm(2, 8), nn.InstanceNorm2d(8))
    anatomy = read(lambda net, x: nn.Sequential(nn.LayerNorm(8), nn.ReLU())(blocks(x).mean((2, 3))))
    assert anatomy.norms == {("batch_norm", "blocks"), ("layer_norm", "head")}


@pytest.mark.parametrize(("rate", "has_dropout"), [(0.0, False), (0.25, True)])
def test_dropout_of_nothing_is_none(rate: float, has_dropout: bool) -> None:
    """With a probability of 0 it drops nothing."""
    assert read(lambda net, x: nn.Dropout(rate)(x)).has_dropout is has_dropout


def test_layers_of_tokens_are_no_head() -> None:
    """A linear layer on every position is not a layer of the head, one on the vector is."""
    anatomy = read(lambda net, x: net.hidden(net.hidden(x.flatten(2).transpose(1, 2)).mean(1)))
    assert (anatomy.hidden, anatomy.head_depth) == (8, 2)


@given(networks())
def test_every_network_of_the_grammar_is_read_as_it_was_written(network: Network) -> None:
    """The grammar knows what it wrote; the steps tell the same without it."""
    network = fit(replace(network, signature=SIGNATURE))
    anatomy = anatomy_of(built(render(network), SIGNATURE.class_name))
    spatial = [block for block in network.blocks if block.kernel > 1]
    assert anatomy.channels == tuple(it.channels for it in spatial)
    assert anatomy.strided == sum(it.down is Down.stride for it in spatial)
    assert anatomy.blocks == len(spatial)
    assert anatomy.max_pools == sum(block.down is Down.max for block in network.blocks)
    hidden = network.head.hidden
    assert (anatomy.hidden, anatomy.head_depth) == (hidden[0].width if hidden else 0, len(hidden) + 1)
    assert ("layer_norm", "head") in anatomy.norms or not any(layer.layer_norm for layer in hidden)
    rates = [block.dropout for block in network.blocks] + [network.head.input_dropout, *(it.dropout for it in hidden)]
    assert anatomy.has_dropout == any(rates)
    assert (("batch_norm", "blocks") in anatomy.norms) == any(it.norm is Norm.batch for it in network.blocks)
    attention = {network.attention, *(block.attention for block in network.blocks)}
    assert anatomy.has_spatial_attention == (Attention.spatial in attention)
    # A projection past a single 1x1 convolution is as long as what it goes past, and so no shortcut.
    sure = [skip for skip in network.skips if any(it.kernel > 1 for it in network.blocks[skip[0] : skip[1]])]
    assert len(sure) <= anatomy.residuals <= len(network.skips)
