"""The measurements of a network by the probe, and a candidate that was admitted with them.

The ranges are those of any traced network. They are checked where a profile is read (`tacevo.typed`): a candidate can
forge one. Sizes are below 2**53, so that descriptors stay finite.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Le, Lt, MaxLen

from tacevo.records import Record

#: The most steps of a pass that are recorded, and the most operands of a step: more than any network that a person
#: would write has, and few enough that a record stays below a megabyte or two.
MOST_STEPS = 5_000

MOST_OPERANDS = 16

_Size = Annotated[int, Ge(0), Lt(2**53)]

_Side = Annotated[float, Ge(0), Lt(2**53)]

#: The names of torch's operations stay below 50 characters.
_Name = Annotated[str, MaxLen(100)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Admitted:
    """A candidate that may be trained."""

    source: str
    profile: Profile


@dataclass(frozen=True, slots=True, kw_only=True)
class Node(Record):
    """One operation of a traced network: one call of a layer or of a functional op."""

    #: Operation type, spelt alike for a layer and its function, e.g. `conv2d`, `max_pool2d`, `add`.
    op: _Name
    #: True where the call uses a weight of two or more dimensions (convolution, linear, attention, einsum with a
    #: parameter); these are the layers that depth counts.
    weighted: bool
    #: Output channels or features of a weighted node, else 0.
    width: _Size


@dataclass(frozen=True, slots=True, kw_only=True)
class Graph(Record):
    """A traced network as data: what the descriptors are computed from (see docs/descriptors.md)."""

    nodes: tuple[Node, ...]
    #: Data flows, as pairs (producer, consumer) of indices into `nodes`, each pair once, producer < consumer.
    edges: tuple[tuple[int, int], ...]
    #: Output channels of every convolution layer, one entry a layer however often it is called.
    channels: tuple[_Size, ...]
    #: Kernel size of every convolution layer, in pixels; the mean of the sides where they differ.
    kernels: tuple[_Side, ...]
    #: Output features of every linear layer but the last one called.
    hidden: tuple[_Size, ...]

    def __post_init__(self) -> None:
        """Raise ValueError where the parts do not fit together, as those of a traced network do."""
        nodes = len(self.nodes)
        rising = all(0 <= producer < consumer < nodes for producer, consumer in self.edges)
        once = len(set(self.edges)) == len(self.edges)
        if not (rising and once and max(len(self.channels) + len(self.hidden), len(self.kernels)) <= nodes):
            raise ValueError("edges, channels, kernels and hidden layers of its own nodes")


@dataclass(frozen=True, slots=True, kw_only=True)
class Step(Record):
    """One call of a traced network in more detail than a node has: what motifs are found in (see docs/motifs.md)."""

    #: Operation type as in `Node`, or the name of an activation, e.g. `leaky_relu`.
    op: _Name
    #: Whether the call uses a weight of two or more dimensions, as in `Node`.
    weighted: bool
    #: The indices of the steps that each operand comes from which depends on the image, in the operands' order: rising,
    #: below this step's own, and none for the image itself.
    sources: Annotated[tuple[tuple[int, ...], ...], MaxLen(MOST_OPERANDS)]
    #: Shapes of these operands for a batch of one image, that dimension included.
    operands: tuple[tuple[_Size, ...], ...]
    #: Shape of the result.
    shape: tuple[_Size, ...]
    #: Sides of a convolution's kernel and its strides, in pixels; else empty.
    kernel: tuple[_Size, ...] = ()
    stride: tuple[_Size, ...] = ()
    #: Groups of a convolution; else 0.
    groups: _Size = 0
    #: Probability of a dropout, in [0, 1]; else 0.
    rate: Annotated[float, Ge(0), Le(1)] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile(Record):
    """The measurements of an admitted candidate by the probe."""

    #: Trainable and frozen parameters, each counted once.
    parameters: Annotated[int, Ge(1), Lt(2**53)]
    #: Floating-point operations of one forward pass of one image, as `torch.utils.flop_counter` counts them.
    flops: _Size
    modules: _Size
    graph: Graph
    #: Kernels that the probe ran and that give other bits on another CPU (docs/determinism.md), in order; the child's
    #: claim, for information.
    not_portable: tuple[str, ...] = ()
    #: The calls of the traced pass, in order; the child's claim, for information, and no part of the descriptors.
    steps: Annotated[tuple[Step, ...], MaxLen(MOST_STEPS)] = ()
    #: Indices of the steps that the network's output comes from, rising.
    output: tuple[int, ...] = ()
    #: Values outside the parameters that a training step changes, and that no layer of torch keeps.
    learnt_outside: _Size = 0
    #: FLOPs that one image takes in a training pass beyond `flops`: of what runs in training only.
    extra_flops: _Size = 0

    def __post_init__(self) -> None:
        """Raise ValueError where a step or the output comes from no earlier step."""
        paired = all(len(step.sources) == len(step.operands) for step in self.steps)
        before = all(_are_rising(one, below=index) for index, step in enumerate(self.steps) for one in step.sources)
        if not (paired and before and _are_rising(self.output, below=len(self.steps))):
            raise ValueError("steps and an output that come from earlier steps")

    @property
    def learnt(self) -> int:
        """Values that a training changes or may change: parameters, and what is learnt outside them."""
        return self.parameters + self.learnt_outside

    @property
    def training_flops(self) -> int:
        """Floating-point operations of one forward pass of one image in training mode; at least `flops`."""
        return self.flops + self.extra_flops


def _are_rising(indices: tuple[int, ...], *, below: int) -> bool:
    return all(0 <= index < below for index in indices) and list(indices) == sorted(set(indices))
