"""Attention is found wherever features are weighted by features, however it is written; and nowhere else."""

from dataclasses import replace

import pytest
import torch
from motif_cases import SIZE, anatomy_of, profile_of
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812 - the customary name, as candidates write it

from analysis.motifs.attention import AttentionKind, find_attention
from analysis.motifs.step_graph import Flow

C = 8


class Weighted(nn.Module):
    """A stem of 8 channels, whatever a test puts behind it, and a head; with a few layers that a test may use."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = nn.Conv2d(3, C, 3, stride=2, padding=1)
        self.one = nn.Conv2d(C, 1, 7, padding=3)
        self.full = nn.Conv2d(C, C, 1)
        self.squeeze = nn.Linear(C, C)
        self.scale = nn.Parameter(torch.ones(1, C, 1, 1))
        self.qkv = nn.Linear(C, 3 * C)
        self.layer = nn.MultiheadAttention(C, 2, batch_first=True)
        self.head = nn.Linear(C, 3)

    def attend(self, x: Tensor) -> Tensor:
        """Leave the map as it is."""
        return x

    def forward(self, x: Tensor) -> Tensor:
        """Run stem, attention and head."""
        x = self.attend(F.relu(self.stem(x)))
        return self.head(x.mean((2, 3)) if x.dim() == 4 else x)  # type: ignore[no-any-return]


class SpatialGate(Weighted):
    """The gate of a spatial attention module, from a convolution."""

    def attend(self, x: Tensor) -> Tensor:
        """One weight a position."""
        return x * torch.sigmoid(self.one(x))


class GateWithoutWeights(Weighted):
    """A spatial gate that no layer computes."""

    def attend(self, x: Tensor) -> Tensor:
        """It summarises the channels, which is what a gate is for."""
        return x.mean(1, keepdim=True).sigmoid().mul(x)


class ExpandedGate(Weighted):
    """A gate of one weight a position, written out for every channel before it is used."""

    def attend(self, x: Tensor) -> Tensor:
        """By its number of weights it is spatial."""
        return self.one(x).sigmoid().expand_as(x) * x  # type: ignore[no-any-return]


class PositionSoftmax(Weighted):
    """Weights that sum to one over the positions."""

    def attend(self, x: Tensor) -> Tensor:
        """Flat, and put back into a map."""
        weights = F.softmax(self.one(x).flatten(1), dim=1).view(len(x), 1, *x.shape[2:])
        return (x * weights).sum((2, 3))


class PooledByAttention(Weighted):
    """A weighted mean over positions as a matrix product."""

    def attend(self, x: Tensor) -> Tensor:
        """The weights come from one map, compared with nothing."""
        weights = F.softmax(self.one(x).flatten(2), dim=-1)
        return torch.bmm(x.flatten(2), weights.transpose(1, 2)).squeeze(2)


class Excitation(Weighted):
    """Squeeze and excitation."""

    def attend(self, x: Tensor) -> Tensor:
        """One weight a channel."""
        return x * torch.sigmoid(self.squeeze(x.mean((2, 3))))[:, :, None, None]


class SummedExcitation(Weighted):
    """Squeeze and excitation, applied by an Einstein sum."""

    def attend(self, x: Tensor) -> Tensor:
        """The weights stay a vector."""
        return torch.einsum("nchw,nc->nchw", x, self.squeeze(x.mean((2, 3))).sigmoid())


class ShiftedExcitation(Weighted):
    """A channel gate that is moved and scaled before it is used."""

    def attend(self, x: Tensor) -> Tensor:
        """Constants and parameters change no kind; neither does an addition of what was there."""
        gate = 1 + self.scale * torch.tanh(self.full(F.adaptive_avg_pool2d(x, 1)))
        return x + x * gate


class Rescaled(Weighted):
    """A spatial gate that is computed on a smaller map."""

    def attend(self, x: Tensor) -> Tensor:
        """It is brought to size before it is used."""
        gate = self.one(F.avg_pool2d(x, 4)).sigmoid()
        return x * F.interpolate(gate, size=x.shape[2:])


class ElementGate(Weighted):
    """A weight for every value."""

    def attend(self, x: Tensor) -> Tensor:
        """Computed by a layer of its own."""
        return x * torch.sigmoid(self.full(x))


class Positions(Weighted):
    """Torch's layer, over the positions of a map."""

    def attend(self, x: Tensor) -> Tensor:
        """Every position looks at every other."""
        tokens = F.avg_pool2d(x, 8).flatten(2).transpose(1, 2)
        return self.layer(tokens, tokens, tokens)[0].mean(1)  # type: ignore[no-any-return]


class FusedPositions(Weighted):
    """The function that the layer is made of."""

    def attend(self, x: Tensor) -> Tensor:
        """Query, key and value come from one layer."""
        query, key, value = self.qkv(F.avg_pool2d(x, 8).flatten(2).transpose(1, 2)).chunk(3, dim=-1)
        return F.scaled_dot_product_attention(query, key, value).mean(1)


class PositionsByHand(Weighted):
    """The same from matrix products."""

    def attend(self, x: Tensor) -> Tensor:
        """Scaled, with dropout on the weights, as textbooks have it."""
        query, key, value = self.qkv(F.avg_pool2d(x, 8).flatten(2).transpose(1, 2)).chunk(3, dim=-1)
        weights = F.dropout(F.softmax(query @ key.transpose(1, 2) / C**0.5, dim=-1), 0.1, self.training)
        return (weights @ value).mean(1)  # type: ignore[no-any-return]


class SummedPositions(Weighted):
    """The same by Einstein sums, in heads."""

    def attend(self, x: Tensor) -> Tensor:
        """What comes out has the shape of the values."""
        query, key, value = self.qkv(F.avg_pool2d(x, 8).flatten(2).transpose(1, 2)).unflatten(2, (3, 2, -1)).unbind(2)
        weights = torch.einsum("bqhd,bkhd->bhqk", query, key).softmax(-1)
        return torch.einsum("bhqk,bkhd->bqhd", weights, value).flatten(2).mean(1)


class SpatialAttention(Weighted):
    """A decoy: nothing but its name attends."""


class Dropped(Weighted):
    """A decoy: the weighted map is computed, and not used."""

    def attend(self, x: Tensor) -> Tensor:
        """Return what came."""
        _ = x * torch.sigmoid(self.one(x))
        return x


class LearnedScale(Weighted):
    """A decoy: the weights are parameters, whatever the image."""

    def attend(self, x: Tensor) -> Tensor:
        """The same for every image."""
        return x * torch.sigmoid(self.scale)


class ExpandedScale(Weighted):
    """A decoy: parameters again, brought to the shape of the map."""

    def attend(self, x: Tensor) -> Tensor:
        """Its shape comes from the image, its values do not."""
        return x * torch.sigmoid(self.scale.expand_as(x))


class SiluByHand(Weighted):
    """A decoy: an activation."""

    def attend(self, x: Tensor) -> Tensor:
        """No layer computes the weight."""
        return x * torch.sigmoid(x)


class Product(Weighted):
    """A decoy: two maps multiplied, neither of which is a weight."""

    def attend(self, x: Tensor) -> Tensor:
        """Nothing holds them in a range."""
        return x * self.one(x)  # type: ignore[no-any-return]


class OneKey(Weighted):
    """A decoy: over a single key every weight is 1."""

    def attend(self, x: Tensor) -> Tensor:
        """A layer of attention that looks at one vector."""
        token = x.mean((2, 3)).unsqueeze(1)
        return self.layer(token, token, token)[0].squeeze(1)  # type: ignore[no-any-return]


class SoftArgmax(Weighted):
    """A decoy: where the map is brightest, as a number."""

    def attend(self, x: Tensor) -> Tensor:
        """Positions are weighted, features are not."""
        weights = F.softmax(x.flatten(2), dim=-1)
        return weights @ torch.linspace(0, 1, weights.shape[-1])


@pytest.mark.parametrize(
    ("model", "kind"),
    [
        (SpatialGate, AttentionKind.spatial),
        (GateWithoutWeights, AttentionKind.spatial),
        (ExpandedGate, AttentionKind.spatial),
        (PositionSoftmax, AttentionKind.spatial),
        (PooledByAttention, AttentionKind.spatial),
        (Rescaled, AttentionKind.spatial),
        (Excitation, AttentionKind.channel),
        (SummedExcitation, AttentionKind.channel),
        (ShiftedExcitation, AttentionKind.channel),
        (ElementGate, AttentionKind.element),
        (Positions, AttentionKind.self),
        (FusedPositions, AttentionKind.self),
        (PositionsByHand, AttentionKind.self),
        (SummedPositions, AttentionKind.self),
    ],
)
def test_attention_is_found_however_it_is_written(model: type[Weighted], kind: AttentionKind) -> None:
    """One place, of one kind."""
    found = find_attention(Flow.of(profile_of(model())))
    assert [attending.kind for attending in found] == [kind]


@pytest.mark.parametrize(
    "decoy", [SpatialAttention, Dropped, LearnedScale, ExpandedScale, SiluByHand, Product, OneKey, SoftArgmax]
)
def test_decoy_attends_to_nothing(decoy: type[Weighted]) -> None:
    """What is called attention, looks like it, or has no effect is none."""
    assert find_attention(Flow.of(profile_of(decoy()))) == ()


@pytest.mark.parametrize("model", [SpatialGate, ShiftedExcitation, Rescaled])
def test_gate_is_no_part_of_the_trunk(model: type[Weighted]) -> None:
    """Its convolution is no block, its sigmoid no activation, its pooling no pooling; x + x * gate is no shortcut."""
    assert replace(anatomy_of(model()), attention=frozenset()) == anatomy_of(Weighted())


def test_images_have_more_positions_than_channels() -> None:
    """A gate of as many weights as there are both would be of no kind that its number tells."""
    assert (SIZE // 2) ** 2 != C
