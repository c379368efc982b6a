"""How a network is built, read off the steps that its probe recorded (definitions: docs/motifs.md).

The trunk is what the output comes from when neither a gate nor a shortcut is followed. Blocks, head, norms, dropouts
and activations are those of the trunk, so the convolution inside an attention module is not a block. No code of a
network is read or run here.
"""

from collections.abc import Sequence, Set
from dataclasses import dataclass

from analysis.motifs.attention import find_gates
from analysis.motifs.step_graph import Flow
from tacevo.gate.operations import CONVOLUTIONS, activation
from tacevo.profile import Profile, Step

#: Normalisations by their operation; one that runs over positions stands in the blocks, else in the head.
_NORMS = {"batch_norm", "layer_norm"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Anatomy:
    """A network's parts."""

    has_spatial_attention: bool
    #: Output channels of every convolution that looks at more than one pixel, in the order of their calls; of a
    #: depthwise one those of the pointwise one that follows it.
    channels: tuple[int, ...]
    #: How many of them have a stride, and the most of them on one path.
    strided: int
    blocks: int
    #: 1x1 convolutions, other than the second half of a separable convolution.
    pointwise: int
    max_pools: int
    #: Output features of the first linear layer on vectors; 0 where it gives the outputs.
    hidden: int
    #: The most linear layers on vectors on one path.
    head_depth: int
    #: By name.
    activations: frozenset[str]
    residuals: int
    #: (operation, `blocks` or `head`).
    norms: frozenset[tuple[str, str]]
    #: A probability of 0 is not a dropout.
    has_dropout: bool


def read_anatomy(profile: Profile) -> Anatomy:
    """Read how a probed network is built."""
    whole = Flow.of(profile)
    gates = find_gates(whole)
    ungated = whole.without((gate.step, gate.operand) for gate in gates)
    shortcuts = _find_shortcuts(ungated)
    trunk = ungated.without(shortcuts)
    steps = [(index, trunk.steps[index]) for index in sorted(trunk.live)]
    halves = _halves(trunk, steps)
    convolutions = [(index, step) for index, step in steps if _is_spatial(step)]
    head = [step.shape[-1] for _, step in steps if _is_head_layer(step)]
    return Anatomy(
        has_spatial_attention=any(gate.is_spatial for gate in gates),
        channels=tuple(halves.get(index, step).shape[1] for index, step in convolutions),
        strided=sum(max(step.stride, default=1) > 1 for _, step in convolutions),
        blocks=trunk.longest(_is_spatial),
        pointwise=sum(_is_pointwise(step) for _, step in steps) - len(halves),
        max_pools=sum(step.op.startswith("max_pool") for _, step in steps),
        hidden=head[0] if len(head) > 1 else 0,
        head_depth=trunk.longest(_is_head_layer),
        activations=frozenset(step.op for _, step in steps if activation(step.op)),
        residuals=len(shortcuts),
        norms=frozenset((step.op, _place(step)) for _, step in steps if step.op in _NORMS),
        has_dropout=any("dropout" in step.op and step.rate > 0 for _, step in steps),
    )


def _is_spatial(step: Step) -> bool:
    return step.op in CONVOLUTIONS and max(step.kernel, default=1) > 1


def _is_pointwise(step: Step) -> bool:
    return step.op in CONVOLUTIONS and max(step.kernel, default=1) == 1


def _is_depthwise(step: Step) -> bool:
    return _is_spatial(step) and 1 < step.groups == step.operands[0][1]


def _is_head_layer(step: Step) -> bool:
    return step.op == "linear" and len(step.shape) == 2


def _halves(trunk: Flow, steps: Sequence[tuple[int, Step]]) -> dict[int, Step]:
    """Find the 1x1 convolutions that directly follow a depthwise one, by the index of that one."""
    depthwise: dict[int, Step] = {}
    for index, step in steps:
        if _is_pointwise(step):
            before = trunk.nearest(index, lambda other: other.weighted)
            depthwise |= {other: step for other in before if _is_depthwise(trunk.steps[other])}
    return depthwise


def _place(step: Step) -> str:
    return "blocks" if len(step.shape) > 3 else "head"


def _find_shortcuts(flow: Flow) -> tuple[tuple[int, int], ...]:
    """Find every residual connection of a network without its gates, so that `x + x * gate(x)` is not one.

    Each is (addition, number of the operand that is the shortcut), in the order of the calls.
    """
    shortcuts = ((index, _shortcut(flow, index)) for index in sorted(flow.live))
    return tuple((index, number) for index, number in shortcuts if number is not None)


def _shortcut(flow: Flow, index: int) -> int | None:
    """Return which operand of an addition goes past what the other one goes through; None where neither does."""
    step = flow.steps[index]
    if step.op != "add" or len(step.operands) != 2 or step.sources[0] == step.sources[1]:
        return None
    first, second = (flow.reaching(sources) for sources in step.sources)
    shared = first & second
    ways = (first - shared, second - shared)
    for number in (0, 1):
        if _passes(flow, short=ways[number], long=ways[1 - number]):
            return number
    return None


def _passes(flow: Flow, *, short: Set[int], long: Set[int]) -> bool:
    """Return whether one way has at most a projection, and the other one layers that this is a way past."""
    projections = [flow.steps[index] for index in short if flow.steps[index].weighted]
    layers = [flow.steps[index] for index in long if flow.steps[index].weighted]
    looks_around = any(max(step.kernel, default=1) > 1 for step in layers)
    projects = len(projections) <= 1 and all(max(step.kernel, default=1) == 1 for step in projections)
    return projects and (len(layers) > len(projections) or looks_around)
