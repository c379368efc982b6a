"""How a network is built, read off the steps that its probe recorded (definitions: docs/motifs.md).

The trunk is what the output comes from when neither the gate of an attention nor a shortcut is followed. Blocks, head,
norms, dropouts and activations are those of the trunk, so the convolution inside an attention module is not a block.
No code of a network is read or run here.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from analysis.motifs.attention import AttentionKind, find_attention
from analysis.motifs.residuals import find_shortcuts
from analysis.motifs.step_graph import Flow
from tacevo.gate.operations import CONVOLUTIONS, activation
from tacevo.profile import Profile, Step

#: What bounds an output besides the activations.
_BOUNDS = {"softmax", "log_softmax", "clamp"}

#: Normalisations by their operation; one that runs over positions stands in the blocks, else in the head.
NORMS = ("batch_norm", "layer_norm", "group_norm", "instance_norm", "rms_norm")


@dataclass(frozen=True, slots=True, kw_only=True)
class Convolution:
    """A convolution of the trunk that looks at more than one pixel."""

    #: Output channels; of a depthwise one those of the pointwise one that follows it.
    channels: int
    #: Longest side of its kernel, in pixels.
    kernel: int
    strided: bool
    #: Whether every channel has a filter of its own.
    depthwise: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Anatomy:
    """A network's parts."""

    #: Each kind that occurs, however often.
    attention: frozenset[AttentionKind]
    #: In the order of their calls.
    convolutions: tuple[Convolution, ...]
    #: The most of them on one path.
    blocks: int
    #: 1x1 convolutions, other than the second half of a separable convolution.
    pointwise: int
    max_pools: int
    average_pools: int
    #: What leaves no or a fixed number of positions: `average`, `max`.
    global_pools: frozenset[str]
    #: Output features of every linear layer on vectors, in the order of their calls; the last gives the outputs.
    head: tuple[int, ...]
    #: The most of them on one path.
    head_depth: int
    #: Those between layers, by name.
    activations: frozenset[str]
    #: What stands behind the last layer with weights and bounds the outputs, by name.
    output: frozenset[str]
    residuals: int
    #: (operation, `blocks` or `head`).
    norms: frozenset[tuple[str, str]]
    #: (`blocks` or `head`, probability), in the order of their calls; a probability of 0 is not a dropout.
    dropouts: tuple[tuple[str, float], ...]

    @property
    def strided(self) -> int:
        """How many convolutions of the trunk have a stride."""
        return sum(convolution.strided for convolution in self.convolutions)

    @property
    def hidden(self) -> tuple[int, ...]:
        """Widths of the hidden layers of the head."""
        return self.head[:-1]


def read_anatomy(profile: Profile) -> Anatomy:
    """Read how a probed network is built."""
    whole = Flow.of(profile)
    attending = find_attention(whole)
    ungated = whole.without((found.step, found.gate) for found in attending)
    shortcuts = find_shortcuts(ungated)
    trunk = ungated.without(shortcuts)
    steps = [(index, trunk.steps[index]) for index in sorted(trunk.live)]
    halves = _halves(trunk, steps)
    outer = _behind_the_last_layer(trunk)
    return Anatomy(
        attention=frozenset(found.kind for found in attending),
        convolutions=tuple(_convolution(step, halves.get(index)) for index, step in steps if _is_spatial(step)),
        blocks=trunk.longest(_is_spatial),
        pointwise=sum(_is_pointwise(step) for _, step in steps) - len(halves),
        max_pools=_count(steps, "max_pool"),
        average_pools=_count(steps, "avg_pool"),
        global_pools=frozenset(name for _, step in steps for name in _global_pool(step)),
        head=tuple(step.shape[-1] for _, step in steps if _is_head_layer(step)),
        head_depth=trunk.longest(_is_head_layer),
        activations=frozenset(step.op for index, step in steps if activation(step.op) and index not in outer),
        output=frozenset(op for index in outer if (op := trunk.steps[index].op) in _BOUNDS or activation(op)),
        residuals=len(shortcuts),
        norms=frozenset((step.op, _place(step)) for _, step in steps if step.op in NORMS),
        dropouts=tuple((_place(step), step.rate) for _, step in steps if "dropout" in step.op and step.rate > 0),
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
    found: dict[int, Step] = {}
    for index, step in steps:
        if _is_pointwise(step):
            before = trunk.nearest(index, lambda other: other.weighted)
            found |= {other: step for other in before if _is_depthwise(trunk.steps[other])}
    return found


def _convolution(step: Step, half: Step | None) -> Convolution:
    return Convolution(
        channels=(half or step).shape[1],
        kernel=max(step.kernel),
        strided=max(step.stride, default=1) > 1,
        depthwise=_is_depthwise(step),
    )


def _count(steps: Sequence[tuple[int, Step]], prefix: str) -> int:
    return sum(step.op.startswith(prefix) for _, step in steps)


def _global_pool(step: Step) -> tuple[str, ...]:
    """Name the pooling that takes a map to no or to a fixed number of positions."""
    if step.op.startswith("adaptive_avg_pool"):
        return ("average",)
    if step.op.startswith("adaptive_max_pool"):
        return ("max",)
    names = {"mean": "average", "amax": "max", "max": "max"}
    shape = step.operands[0]
    loses_positions = len(shape) == 4 and step.shape[:2] == shape[:2] and set(step.shape[2:]) <= {1}
    return (names[step.op],) if step.op in names and loses_positions else ()


def _behind_the_last_layer(trunk: Flow) -> frozenset[int]:
    """Return the steps between the last layers with weights and the output."""
    found: set[int] = set()
    waiting = list(trunk.ends)
    while waiting:
        index = waiting.pop()
        if index not in found and not trunk.steps[index].weighted:
            found.add(index)
            waiting += trunk.sources(index)
    return frozenset(found)


def _place(step: Step) -> str:
    return "blocks" if len(step.shape) > 3 else "head"
