"""What the probe measures of a network, and a candidate that was admitted with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from tacevo.records import Json


@dataclass(frozen=True, slots=True, kw_only=True)
class Admitted:
    """A candidate that may be trained."""

    source: str
    profile: Profile


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """One operation of a traced network: one call of a layer or of a functional op."""

    #: Operation type, spelt alike for a layer and its function, e.g. `conv2d`, `max_pool2d`, `add`.
    op: str
    #: True where the call uses a weight of two or more dimensions (convolution, linear, attention, einsum with a
    #: parameter); these are the layers that depth counts.
    weighted: bool
    #: Output channels or features of a weighted node, else 0.
    width: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Graph:
    """A traced network as data: what the descriptors are computed from (see docs/descriptors.md)."""

    nodes: tuple[Node, ...]
    #: Data flows, as pairs (producer, consumer) of indices into `nodes`, each pair once, producer < consumer.
    edges: tuple[tuple[int, int], ...]
    #: Output channels of every convolution layer, one entry a layer however often it is called.
    channels: tuple[int, ...]
    #: Kernel size of every convolution layer, in pixels; the mean of the sides where they differ.
    kernels: tuple[float, ...]
    #: Output features of every linear layer but the last one called.
    hidden: tuple[int, ...]

    @classmethod
    def from_json(cls, value: Mapping[str, Json]) -> Self:
        """Read what `to_json` wrote."""
        return cls(
            nodes=tuple(Node(**node) for node in value["nodes"]),
            edges=tuple((a, b) for a, b in value["edges"]),
            channels=tuple(value["channels"]),
            kernels=tuple(value["kernels"]),
            hidden=tuple(value["hidden"]),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One call of a traced network in more detail than a node has: what motifs are found in (see docs/motifs.md)."""

    #: Operation type as in `Node`, or the name of an activation, e.g. `leaky_relu`.
    op: str
    #: As in `Node`.
    weighted: bool
    #: For each operand that depends on the image, in order, the indices of the steps that it comes from: rising, below
    #: this step's own, and none for the image itself.
    sources: tuple[tuple[int, ...], ...]
    #: Shapes of these operands for a batch of one image, that dimension included.
    operands: tuple[tuple[int, ...], ...]
    #: Shape of the result.
    shape: tuple[int, ...]
    #: Sides of a convolution's kernel and its strides, in pixels; else empty.
    kernel: tuple[int, ...] = ()
    stride: tuple[int, ...] = ()
    #: Groups of a convolution; else 0.
    groups: int = 0
    #: Probability of a dropout, in [0, 1]; else 0.
    rate: float = 0.0

    @classmethod
    def from_json(cls, value: Mapping[str, Json]) -> Self:
        """Read what `to_json` wrote."""
        nested = {name: tuple(tuple(entry) for entry in value[name]) for name in ("sources", "operands")}
        flat = {name: tuple(value[name]) for name in ("shape", "kernel", "stride")}
        return cls(**{**value, **nested, **flat})


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """What the probe measured of an admitted candidate."""

    #: Trainable and frozen parameters, each counted once.
    parameters: int
    #: Floating-point operations of one forward pass of one image, as `torch.utils.flop_counter` counts them.
    flops: int
    modules: int
    graph: Graph
    #: Kernels that the probe ran and that give other bits on another CPU (docs/determinism.md), in order; the child's
    #: claim, for information.
    not_portable: tuple[str, ...] = ()
    #: The calls of the traced pass, in order; the child's claim, for information, and no part of the descriptors.
    steps: tuple[Step, ...] = ()
    #: Indices of the steps that the network's output comes from, rising.
    output: tuple[int, ...] = ()

    @classmethod
    def from_json(cls, value: Mapping[str, Json]) -> Self:
        """Read what `to_json` wrote."""
        return cls(
            parameters=value["parameters"],
            flops=value["flops"],
            modules=value["modules"],
            graph=Graph.from_json(value["graph"]),
            not_portable=tuple(value["not_portable"]),
            steps=tuple(Step.from_json(step) for step in value["steps"]),
            output=tuple(value["output"]),
        )
