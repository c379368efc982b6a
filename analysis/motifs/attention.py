"""Attention by what it does: features weighted by what was computed from features (definitions: docs/motifs.md)."""

import math
from dataclasses import dataclass

from analysis.motifs.step_graph import Flow
from tacevo.profile import Step

#: What brings a weight into a range.
_SQUASHING = {"sigmoid", "hardsigmoid", "softmax", "tanh"}

#: What may be done to a weight before it is used, as long as nothing else of the image comes in.
_HARMLESS = {"add", "sub", "rsub", "mul", "div", "clamp", "neg", "interpolate", "dropout"}

_PRODUCTS = {"matmul", "einsum"}


@dataclass(frozen=True, slots=True, kw_only=True)
class AttentionGate:
    """One place where a network weights its features."""

    #: Index of the step that applies the weights.
    step: int
    #: Number of the operand that holds them.
    operand: int
    #: Whether there is a weight for each position, as in spatial attention.
    is_spatial: bool


def find_gates(flow: Flow) -> tuple[AttentionGate, ...]:
    """Find every gate whose result reaches the output; one that is computed and dropped attends to nothing."""
    gates = (_gate(flow, index) for index in sorted(flow.live))
    return tuple(gate for gate in gates if gate is not None)


def _gate(flow: Flow, index: int) -> AttentionGate | None:
    step = flow.steps[index]
    if len(step.operands) != 2 or step.op not in {"mul", *_PRODUCTS}:
        return None
    for operand in (1, 0):
        squash = _squash(flow, step.sources[operand])
        if squash is not None:
            is_weighting = step.op == "mul" or _spreads(step, operand)
            spatial = _weights_positions(flow, index, operand, squash) if is_weighting else _mixes(flow, squash)
            if spatial is not None:
                return AttentionGate(step=index, operand=operand, is_spatial=spatial)
    return None


def _spreads(step: Step, operand: int) -> bool:
    """Return whether a product multiplies fewer weights into a map that keeps its shape, as `nchw,nc->nchw` does."""
    data, weights = step.operands[1 - operand], step.operands[operand]
    return step.op == "einsum" and step.shape == data and len(weights) < len(data)


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


def _weights_positions(flow: Flow, index: int, operand: int, squash: int) -> bool | None:
    """Return by the shapes of a product whether it has a weight for each position; None where it is no gate."""
    step = flow.steps[index]
    data, weights = step.operands[1 - operand], step.operands[operand]
    if len(data) == 4 and min(data[1], math.prod(data[2:])) > 1:
        channels, positions = data[1], math.prod(data[2:])
        # By the shape that is applied, or, where that was expanded to the whole map, by how many weights there are.
        applied = {(channels, 1): False, (1, positions): True}
        if len(weights) == 4 and (weights[1], math.prod(weights[2:])) in applied:
            return applied[weights[1], math.prod(weights[2:])]
        distinct = {channels: False, positions: True}
        if channels != positions and math.prod(flow.steps[squash].shape) in distinct:
            return distinct[math.prod(flow.steps[squash].shape)]
    learned = flow.reaching(step.sources[operand]) - flow.reaching(step.sources[1 - operand])
    # x * sigmoid(x) is an activation, not a gate: its weight is computed by no layer of its own.
    return False if any(flow.steps[other].weighted for other in learned) else None


def _mixes(flow: Flow, squash: int) -> bool | None:
    """Return by the source of a weighted sum's weights whether they are of positions; None where it is no such sum."""
    step = flow.steps[squash]
    if step.op != "softmax" or math.prod(step.shape) == 1:
        return None
    scores = flow.nearest(squash, lambda other: other.op not in _HARMLESS)
    # Weights that come from a comparison of positions are those of self-attention.
    return not any(flow.steps[other].op in _PRODUCTS and len(flow.steps[other].operands) > 1 for other in scores)
