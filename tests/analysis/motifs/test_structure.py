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

from analysis.motifs.structure import Anatomy, Convolution
from tacevo.llm.grammar.bounds import fit
from tacevo.llm.grammar.network import Attention, Down, Network, Norm
from tacevo.llm.grammar.rendering import render

Steps = Callable[["Layers", Tensor], Tensor]


class Layers(nn.Module):
    """A stem of 8 channels, steps that a test chooses, and a linear layer; with layers that the steps may use."""

    def __init__(self, steps: Steps, outputs: Steps = lambda net, x: x) -> None:
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
        self.steps, self.outputs = steps, outputs

    def forward(self, x: Tensor) -> Tensor:
        """Run stem, steps, mean over positions, last layer and outputs."""
        x = self.steps(self, self.stem(x))
        return self.outputs(self, self.last(x.mean((2, 3)) if x.dim() == 4 else x))


def read(steps: Steps, outputs: Steps = lambda net, x: x) -> Anatomy:
    """Read a network of these steps."""
    return anatomy_of(Layers(steps, outputs))


@pytest.mark.parametrize("task", CLASSES)
def test_baseline_is_read_by_hand(task: str) -> None:
    """Three blocks of 32, 64 and 128 channels with max pooling, a hidden layer of 512 with dropout."""
    blocks = tuple(Convolution(channels=width, kernel=3, strided=False, depthwise=False) for width in (32, 64, 128))
    assert baseline(task) == Anatomy(
        attention=frozenset(),
        convolutions=blocks,
        blocks=3,
        pointwise=0,
        max_pools=3,
        average_pools=0,
        global_pools=frozenset({"average"}),
        head=(512, {"force": 3, "grating": 7, "hardness": 1}[task]),
        head_depth=2,
        activations=frozenset({"relu"}),
        output=frozenset(),
        residuals=0,
        norms=frozenset(),
        dropouts=(("head", 0.5),),
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
    found = read(lambda net, x: net.point(F.avg_pool2d(x, 2)) + net.same(F.max_pool2d(x, 2)))
    assert (found.pointwise, found.average_pools, found.max_pools, found.blocks) == (0, 0, 1, 2)


def test_separable_convolution_is_one_block() -> None:
    """Its width is that of its second half, which is not a 1x1 convolution of its own."""
    found = read(lambda net, x: net.narrow(net.wide(net.depthwise(x).relu()).relu()))
    assert found.convolutions[1] == Convolution(channels=16, kernel=3, strided=False, depthwise=True)
    assert (found.blocks, found.pointwise) == (2, 1)


def test_blocks_are_counted_along_a_path() -> None:
    """Two branches side by side are one block deep."""
    found = read(lambda net, x: net.same(x) + net.other(x))
    assert (found.blocks, len(found.convolutions)) == (2, 3)


def test_stride_and_pooling_are_told_apart() -> None:
    """One step of each kind."""
    strided = nn.Conv2d(8, 8, 3, stride=(1, 2))
    found = read(lambda net, x: F.avg_pool2d(F.max_pool2d(F.conv2d(x, strided.weight, stride=(1, 2)), 2), 2))
    assert (found.strided, found.max_pools, found.average_pools) == (1, 1, 1)


def test_unused_layers_are_no_part() -> None:
    """The class above has many; one whose result is thrown away is none either."""
    found = read(lambda net, x: (net.same(x), x)[1])
    assert (len(found.convolutions), found.head) == (1, (3,))


@pytest.mark.parametrize(
    ("steps", "pools"),
    [
        (lambda net, x: F.adaptive_max_pool2d(x, 4).mean((2, 3)), {"average", "max"}),
        (lambda net, x: x.amax((2, 3)), {"max"}),
        (lambda net, x: x.flatten(2).max(2)[0][:, :, None, None].relu(), {"average"}),
        (lambda net, x: x.mean((2, 3)) + x.amax((2, 3)), {"average", "max"}),
        (lambda net, x: x.mean(1, keepdim=True).expand(-1, 8, -1, -1), {"average"}),
    ],
    ids=["fixed grid", "no positions", "flat", "both", "over channels"],
)
def test_global_pooling_takes_all_positions(steps: Steps, pools: set[str]) -> None:
    """A mean over channels is none; the networks above end in a mean unless the steps did already."""
    assert read(steps).global_pools == pools


@pytest.mark.parametrize(
    ("outputs", "name"),
    [
        (lambda net, x: x.sigmoid(), "sigmoid"),
        (lambda net, x: 2 * torch.tanh(x), "tanh"),
        (lambda net, x: F.hardtanh(x), "hardtanh"),
        (lambda net, x: x.clamp(0, 1), "clamp"),
        (lambda net, x: F.softmax(x, 1), "softmax"),
    ],
)
def test_output_is_what_bounds_it(outputs: Steps, name: str) -> None:
    """And the same function between layers is an activation."""
    found = read(lambda net, x: x.relu(), outputs)
    assert [found.output, found.activations] == [{name}, {"relu"}]
    assert read(lambda net, x: x.sigmoid()).output == frozenset()


def test_norms_and_dropouts_have_a_place() -> None:
    """In the blocks they see a map, in the head a vector; dropout with probability 0 is none."""
    blocks = nn.Sequential(nn.BatchNorm2d(8), nn.GroupNorm(2, 8), nn.InstanceNorm2d(8), nn.Dropout2d(0.1))
    head = nn.Sequential(nn.LayerNorm(8), nn.Dropout(0.0), nn.Dropout(0.25))
    found = read(lambda net, x: head(blocks(x).mean((2, 3))))
    names = {("batch_norm", "blocks"), ("group_norm", "blocks"), ("instance_norm", "blocks"), ("layer_norm", "head")}
    assert found.norms == names
    assert found.dropouts == (("blocks", 0.1), ("head", 0.25))


def test_layers_of_tokens_are_no_head() -> None:
    """A linear layer on every position is not a layer of the head, one on the vector is."""
    found = read(lambda net, x: net.hidden(net.hidden(x.flatten(2).transpose(1, 2)).mean(1)))
    assert (found.head, found.hidden, found.head_depth) == ((8, 3), (8,), 2)


@given(networks())
def test_every_network_of_the_grammar_is_read_as_it_was_written(network: Network) -> None:
    """The grammar knows what it wrote; the steps tell the same without it."""
    network = fit(replace(network, signature=SIGNATURE))
    found = anatomy_of(built(render(network), SIGNATURE.class_name))
    spatial = [block for block in network.blocks if block.kernel > 1]
    layers = [(it.channels, it.kernel, it.down is Down.stride, it.separable) for it in spatial]
    assert [(it.channels, it.kernel, it.strided, it.depthwise) for it in found.convolutions] == layers
    assert found.blocks == len(spatial)
    assert (found.max_pools, found.average_pools) == tuple(
        sum(block.down is down for block in network.blocks) for down in (Down.max, Down.average)
    )
    assert found.hidden == tuple(hidden.width for hidden in network.head.hidden)
    assert ("layer_norm", "head") in found.norms or not any(hidden.layer_norm for hidden in network.head.hidden)
    rates = [block.dropout for block in network.blocks] + [network.head.input_dropout]
    rates += [hidden.dropout for hidden in network.head.hidden]
    assert [rate for _, rate in found.dropouts] == [rate for rate in rates if rate]
    assert {name for name, place in found.norms if place == "blocks"} == {
        {Norm.batch: "batch_norm", Norm.group: "group_norm"}[block.norm] for block in network.blocks if block.norm
    }
    attention = {network.attention, *(block.attention for block in network.blocks)} - {Attention.none}
    assert {kind.value for kind in found.attention} == {kind.name for kind in attention}
    # A projection past a single 1x1 convolution is as long as what it goes past, and so no shortcut.
    sure = [skip for skip in network.skips if any(it.kernel > 1 for it in network.blocks[skip[0] : skip[1]])]
    assert len(sure) <= found.residuals <= len(network.skips)
    assert bool(found.output) == bool(network.head.output)
