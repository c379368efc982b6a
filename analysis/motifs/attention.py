"""Attention by what it does: features weighted by what was computed from features (definitions: docs/motifs.md)."""

import math
from dataclasses import dataclass
from enum import StrEnum

from analysis.motifs.step_graph import Flow
from tacevo.profile import Step

#: What brings a weight into a range.
_SQUASHING = {"sigmoid", "hardsigmoid", "softmax", "tanh"}

#: What may be done to a weight before it is used, as long as nothing else of the image comes in.
_HARMLESS = {"add", "sub", "rsub", "mul", "div", "clamp", "neg", "interpolate", "dropout"}

_PRODUCTS = {"matmul", "einsum"}


class AttentionKind(StrEnum):
    """What the weights of an attention are for."""

    spatial = "spatial"
    channel = "channel"
    self = "self"
    element = "element"


@dataclass(frozen=True, slots=True, kw_only=True)
class Attending:
    """One place where a network attends."""

    kind: AttentionKind
    #: Index of the step that applies the weights.
    step: int
    #: Number of the operand that holds the weights; -1 where they are inside of the step.
    gate: int


def find_attention(flow: Flow) -> tuple[Attending, ...]:
    """Find every attention whose result reaches the output; one that is computed and dropped attends to nothing."""
    found = (_attending(flow, index) for index in sorted(flow.live))
    return tuple(attending for attending in found if attending is not None)


def _attending(flow: Flow, index: int) -> Attending | None:
    step = flow.steps[index]
    if step.op in {"multihead_attention", "scaled_dot_product_attention"}:
        return Attending(kind=AttentionKind.self, step=index, gate=-1) if _keys(flow, index) > 1 else None
    if len(step.operands) != 2 or step.op not in {"mul", *_PRODUCTS}:
        return None
    for gate in (1, 0):
        squash = _squash(flow, step.sources[gate])
        if squash is not None:
            applied = step.op == "mul" or _spreads(step, gate)
            kind = _weighting(flow, index, gate, squash) if applied else _mixing(flow, squash)
            if kind is not None:
                return Attending(kind=kind, step=index, gate=gate)
    return None


def _spreads(step: Step, gate: int) -> bool:
    """Return whether a product multiplies fewer weights into a map that keeps its shape, as `nchw,nc->nchw` does."""
    data, weights = step.operands[1 - gate], step.operands[gate]
    return step.op == "einsum" and step.shape == data and len(weights) < len(data)


def _keys(flow: Flow, index: int) -> int:
    """Count what an attention layer attends to; over a single key its weight is always 1."""
    step = flow.steps[index]
    key = step.operands[min(1, len(step.operands) - 1)]
    if step.op == "scaled_dot_product_attention":
        return key[-2]
    return math.prod(key[:-1])  # the batch is one image, at any position of that dimension


def _squash(flow: Flow, sources: tuple[int, ...]) -> int | None:
    """Find the step that brought an operand into its range, with nothing but constants applied since."""
    while len(sources) == 1:
        (index,) = sources
        step = flow.steps[index]
        if step.op in _SQUASHING:
            return index
        if step.op not in _HARMLESS or len(step.sources) != 1:
            return None
        sources = step.sources[0]
    return None


def _weighting(flow: Flow, index: int, gate: int, squash: int) -> AttentionKind | None:
    """Find by the shapes of a product what its weights are for."""
    step = flow.steps[index]
    data, weights = step.operands[1 - gate], step.operands[gate]
    if len(data) == 4 and min(data[1], math.prod(data[2:])) > 1:
        channels, positions = data[1], math.prod(data[2:])
        distinct = {channels: AttentionKind.channel, positions: AttentionKind.spatial}
        # By the shape that is applied, or, where that was expanded to the whole map, by how many weights there are.
        applied = {(channels, 1): AttentionKind.channel, (1, positions): AttentionKind.spatial}
        if len(weights) == 4 and (weights[1], math.prod(weights[2:])) in applied:
            return applied[weights[1], math.prod(weights[2:])]
        if channels != positions and math.prod(flow.steps[squash].shape) in distinct:
            return distinct[math.prod(flow.steps[squash].shape)]
    learned = flow.reaching(step.sources[gate]) - flow.reaching(step.sources[1 - gate])
    # x * sigmoid(x) is an activation, not attention: its weight is computed by no layer of its own.
    return AttentionKind.element if any(flow.steps[other].weighted for other in learned) else None


def _mixing(flow: Flow, squash: int) -> AttentionKind | None:
    """Find by the source of the weights of a weighted sum what they are for."""
    step = flow.steps[squash]
    if step.op != "softmax" or math.prod(step.shape) == 1:
        return None
    scores = flow.nearest(squash, lambda other: other.op not in _HARMLESS)
    compared = any(flow.steps[other].op in _PRODUCTS and len(flow.steps[other].operands) > 1 for other in scores)
    return AttentionKind.self if compared else AttentionKind.spatial
