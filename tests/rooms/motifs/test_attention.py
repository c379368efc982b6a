"""Attention is found wherever features are weighted by features, however it is written; and nowhere else."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from motif_cases import anatomy_of, profile_of
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812 - the customary name, as candidates write it

from analysis.motifs.attention import find_gates
from analysis.motifs.step_graph import Flow

C = 8


class Weighted(nn.Module):
    """A stem of 8 channels, whatever a test puts behind it, and a head; with a few layers that a test may use."""

    def __init__(self, attend: "Attend" = lambda net, x: x) -> None:
        super().__init__()
        self.attend = attend
        self.stem = nn.Conv2d(3, C, 3, stride=2, padding=1)
        self.one = nn.Conv2d(C, 1, 7, padding=3)
        self.full = nn.Conv2d(C, C, 1)
        self.squeeze = nn.Linear(C, C)
        self.scale = nn.Parameter(torch.ones(1, C, 1, 1))
        self.qkv = nn.Linear(C, 3 * C)
        self.layer = nn.MultiheadAttention(C, 2, batch_first=True)
        self.head = nn.Linear(C, 3)

    def forward(self, x: Tensor) -> Tensor:
        """Run stem, attention and head."""
        x = self.attend(self, F.relu(self.stem(x)))
        return self.head(x.mean((2, 3)) if x.dim() == 4 else x)  # type: ignore[no-any-return]

    def excitation(self, x: Tensor) -> Tensor:
        """Return a weight for each channel, shape (images, C)."""
        return torch.sigmoid(self.squeeze(x.mean((2, 3))))

    def tokens(self, x: Tensor) -> Tensor:
        """Return the positions of a smaller map, shape (images, positions, C)."""
        return F.avg_pool2d(x, 8).flatten(2).transpose(1, 2)


Attend = Callable[[Weighted, Tensor], Tensor]


def spatial_gate(net: Weighted, x: Tensor) -> Tensor:
    """One weight a position, from a convolution."""
    return x * torch.sigmoid(net.one(x))


def shifted_excitation(net: Weighted, x: Tensor) -> Tensor:
    """Constants and parameters change no kind; neither does an addition of what was there."""
    return x + x * (1 + net.scale * torch.tanh(net.full(F.adaptive_avg_pool2d(x, 1))))


def rescaled(net: Weighted, x: Tensor) -> Tensor:
    """A spatial gate that is computed on a smaller map, and brought to size before it is used."""
    return x * F.interpolate(net.one(F.avg_pool2d(x, 4)).sigmoid(), size=x.shape[2:])


def fused_positions(net: Weighted, x: Tensor) -> Tensor:
    """The function that torch's layer is made of, whose weights no step applies."""
    return F.scaled_dot_product_attention(*net.qkv(net.tokens(x)).chunk(3, dim=-1)).mean(1)


def positions_by_hand(net: Weighted, x: Tensor) -> Tensor:
    """The same from matrix products, scaled, with dropout on the weights, as textbooks have it."""
    query, key, value = net.qkv(net.tokens(x)).chunk(3, dim=-1)
    weights = F.dropout(F.softmax(query @ key.transpose(1, 2) / C**0.5, dim=-1), 0.1, net.training)
    return (weights @ value).mean(1)  # type: ignore[no-any-return]


def scores_twice(net: Weighted, x: Tensor) -> Tensor:
    """Positions again; the scores reach the softmax on two paths."""
    query, key, value = net.qkv(net.tokens(x)).chunk(3, dim=-1)
    scores = query @ key.transpose(1, 2)
    return (F.softmax(scores / C**0.5 + scores, dim=-1) @ value).mean(1)  # type: ignore[no-any-return]


def summed_positions(net: Weighted, x: Tensor) -> Tensor:
    """The same by Einstein sums, in heads; what comes out has the shape of the values."""
    query, key, value = net.qkv(net.tokens(x)).unflatten(2, (3, 2, -1)).unbind(2)
    weights = torch.einsum("bqhd,bkhd->bhqk", query, key).softmax(-1)
    return torch.einsum("bhqk,bkhd->bqhd", weights, value).flatten(2).mean(1)


def soft_argmax(net: Weighted, x: Tensor) -> Tensor:
    """Where the map is brightest, as a number: positions are weighted, features are not."""
    weights = F.softmax(x.flatten(2), dim=-1)
    return weights @ torch.linspace(0, 1, weights.shape[-1])


#: Whether the weights are of positions, and the network.
ATTENDING: dict[str, tuple[bool, Attend]] = {
    "gate": (True, spatial_gate),
    "gate that no layer computes": (True, lambda net, x: x.mean(1, keepdim=True).sigmoid().mul(x)),
    "gate written out for every channel": (True, lambda net, x: net.one(x).sigmoid().expand_as(x) * x),
    "softmax over positions": (
        True,
        lambda net, x: (x * F.softmax(net.one(x).flatten(1), 1).view(len(x), 1, *x.shape[2:])).sum((2, 3)),
    ),
    "weighted mean as a matrix product": (
        True,
        lambda net, x: torch.bmm(x.flatten(2), F.softmax(net.one(x).flatten(2), dim=-1).mT).squeeze(2),
    ),
    "gate on a smaller map": (True, rescaled),
    "squeeze and excitation": (False, lambda net, x: x * net.excitation(x)[:, :, None, None]),
    "excitation by an Einstein sum": (
        False,
        lambda net, x: torch.einsum("nchw,nc->nchw", x, net.excitation(x)),
    ),
    "moved and scaled gate": (False, shifted_excitation),
    "weight for every value": (False, lambda net, x: x * torch.sigmoid(net.full(x))),
    "positions by hand": (False, positions_by_hand),
    "positions whose scores come twice": (False, scores_twice),
    "positions by Einstein sums": (False, summed_positions),
}


class SpatialAttention(Weighted):
    """A decoy: nothing but its name attends."""


class ImageAsWeight(Weighted):
    """A decoy: the image itself, which no step computes, multiplies the map."""

    def forward(self, x: Tensor) -> Tensor:
        """Multiply every channel by the first colour."""
        return self.head((F.relu(self.stem(x)) * x[:, :1, ::2, ::2]).mean((2, 3)))  # type: ignore[no-any-return]


DECOYS: dict[str, nn.Module] = {
    "name alone": SpatialAttention(),
    "weighted map that is not used": Weighted(lambda net, x: (spatial_gate(net, x), x)[1]),
    "parameters": Weighted(lambda net, x: x * torch.sigmoid(net.scale)),
    "parameters in the shape of the map": Weighted(lambda net, x: x * torch.sigmoid(net.scale.expand_as(x))),
    "parameters as they are": Weighted(lambda net, x: x * net.scale),
    "sum of one part": Weighted(
        lambda net, x: (F.softmax(net.one(x).mean((2, 3)), 1)[:, None] @ x.mean((2, 3))[:, None]).squeeze(1)
    ),
    "activation by hand": Weighted(lambda net, x: x * torch.sigmoid(x)),
    "product of maps that nothing holds in a range": Weighted(lambda net, x: x * net.one(x)),
    "image as a weight": ImageAsWeight(),
    "where the map is brightest": Weighted(soft_argmax),
    "layer over positions": Weighted(lambda net, x: net.layer(*[net.tokens(x)] * 3)[0].mean(1)),
    "function over positions": Weighted(fused_positions),
}


@pytest.mark.parametrize(("is_spatial", "attend"), ATTENDING.values(), ids=ATTENDING)
def test_gate_is_found_however_it_is_written(is_spatial: bool, attend: Attend) -> None:
    """One place, and what its weights are of."""
    assert [gate.is_spatial for gate in find_gates(Flow.of(profile_of(Weighted(attend))))] == [is_spatial]


@pytest.mark.parametrize("decoy", DECOYS.values(), ids=DECOYS)
def test_decoy_has_no_gate(decoy: nn.Module) -> None:
    """What is called attention, looks like it, or has no effect is none."""
    assert find_gates(Flow.of(profile_of(decoy))) == ()


@pytest.mark.parametrize(
    ("attend", "is_spatial"), [(spatial_gate, True), (shifted_excitation, False), (rescaled, True)]
)
def test_gate_is_no_part_of_the_trunk(attend: Attend, is_spatial: bool) -> None:
    """Its convolution is not a block, nor its sigmoid an activation, its pooling a pooling, x + x * gate a shortcut."""
    assert anatomy_of(Weighted(attend)) == replace(anatomy_of(Weighted()), has_spatial_attention=is_spatial)
