"""Descriptors are the paper's formulas: every expected number here is computed by hand from a graph in graphs.py.

Logarithms used below: log2 3 = 1.584962501, and -log2 of 0.2, 0.4, 0.6 is 2.321928095, 1.321928095, 0.736965594.
"""

from dataclasses import replace
from random import Random

import pytest
from graphs import BRANCH, CHAIN, EINSUM, NO_HIDDEN_LAYER, ONE_LAYER, RESIDUAL, SHARED
from hypothesis import given
from hypothesis import strategies as st

from tacevo.evolution.descriptors import density, depth, describe, entropy, variation, width
from tacevo.profile import Graph, Node, Profile

EMPTY = Graph(nodes=(), edges=(), channels=(), kernels=(), hidden=())

_sizes = st.lists(st.integers(0, 512), max_size=6).map(tuple)


@st.composite
def graphs(draw: st.DrawFn) -> Graph:
    """Any graph that tracing can give, up to eight nodes."""
    ops = draw(st.lists(st.sampled_from(["conv2d", "linear", "add", "max_pool2d"]), max_size=8))
    nodes = tuple(Node(op=op, weighted=op in ("conv2d", "linear"), width=draw(st.integers(1, 64))) for op in ops)
    pairs = [(a, b) for b in range(len(nodes)) for a in range(b)]
    edges = tuple(pair for pair in pairs if draw(st.booleans()))
    kernels = tuple(float(size) for size in draw(_sizes)[: len(nodes)])
    channels = draw(_sizes)[: len(nodes)]
    hidden = draw(_sizes)[: len(nodes) - len(channels)]
    return Graph(nodes=nodes, edges=edges, channels=channels, kernels=kernels, hidden=hidden)


@pytest.mark.parametrize(
    ("graph", "parts", "size"),
    [
        # Shares 2/5, 1/5, 2/5; 4 of 10 connections; deviations 2/6, 1/4 and 0/6.
        (CHAIN, ((2 * 0.4 * 1.321928095 + 0.2 * 2.321928095) / 1.584962501, 0.4, (2 / 6 + 1 / 4 + 0) / 3), (4, 8)),
        # The skip adds a fifth connection; shares 2/5, 1/5, 1/5, 1/5; equal layers vary by 0.
        (RESIDUAL, ((0.4 * 1.321928095 + 3 * 0.2 * 2.321928095) / 2, 0.5, 0.0), (3, 4)),
        # Branches stand beside each other, so one convolution counts for depth; deviations 2/6 and 1/2.
        (BRANCH, ((0.4 * 1.321928095 + 3 * 0.2 * 2.321928095) / 2, 0.4, (1 / 3 + 1 / 2) / 2), (2, 8)),
        # Two calls of one layer are two nodes and two steps of depth: shares 3/5, 1/5, 1/5.
        (SHARED, ((0.6 * 0.736965594 + 2 * 0.2 * 2.321928095) / 1.584962501, 0.4, 0.0), (4, 4)),
        # Three types used once each are as even as can be; einsum with a parameter is a layer; two thirds, rounded.
        (EINSUM, (1.0, 0.666666666667, 0.0), (2, 5)),
        # Without a hidden layer the mean is over two deviations, 4/8 and 0, and not over three.
        (NO_HIDDEN_LAYER, ((0.5 * 1 + 2 * 0.25 * 2) / 1.584962501, 0.5, 0.25), (3, 12)),
        # One type makes log2 N = 0, one node makes no pair, and no property is left: all 0 by definition.
        (ONE_LAYER, (0.0, 0.0, 0.0), (1, 3)),
        (replace(ONE_LAYER, nodes=(Node(op="linear", weighted=True, width=4),) * 3), (0.0, 0.0, 0.0), (1, 4)),
        # A network that only reshapes its input: depth and width stay usable as divisors.
        (EMPTY, (0.0, 0.0, 0.0), (1, 1)),
    ],
)
def test_parts_are_those_of_the_formulas(
    graph: Graph, parts: tuple[float, float, float], size: tuple[int, int]
) -> None:
    """Entropy, density and variation; depth and width."""
    even, dense, varied = parts
    assert (entropy(graph), variation(graph)) == pytest.approx((even, varied))
    assert (density(graph), depth(graph), width(graph)) == (dense, *size)


def test_property_of_zeros_varies_by_nothing() -> None:
    """A hidden layer of width 0, as of honest code, has no mean to divide by; it counts as one without variation."""
    assert variation(replace(CHAIN, channels=(), kernels=(), hidden=(0,))) == 0.0
    assert variation(replace(CHAIN, channels=(2, 6), kernels=(), hidden=(0, 0))) == 0.25


def test_describe_joins_the_parts() -> None:
    """For the chain, 1000 FLOPs and 50 parameters: efficiency is 1000 / (50 x 8 / 4) = 10."""
    point = describe(Profile(parameters=50, flops=1000, modules=9, graph=CHAIN))
    assert point.eff_ratio == 10.0
    assert point.arch_div == pytest.approx((0.960230 + 0.4 + 7 / 36) / 3, abs=1e-6)
    assert (point.entropy, point.density, point.variation) == (entropy(CHAIN), density(CHAIN), variation(CHAIN))


def test_network_without_parameters_has_no_efficiency() -> None:
    """Division by zero is refused with the field's name."""
    with pytest.raises(ValueError, match=r"profile.parameters must be >= 1; got 0"):
        describe(Profile(parameters=0, flops=1, modules=1, graph=CHAIN))


@given(graphs())
def test_parts_stay_in_their_ranges(graph: Graph) -> None:
    """Entropy and density are shares, variation is not negative, and the path is no longer than the network."""
    assert 0.0 <= entropy(graph) <= 1.0
    assert 0.0 <= density(graph) <= 1.0
    assert variation(graph) >= 0.0
    assert 1 <= depth(graph) <= max(1, len(graph.nodes))
    assert width(graph) >= 1


@given(graphs(), st.randoms(use_true_random=False))
def test_entropy_ignores_the_order_of_nodes_and_what_types_are_called(graph: Graph, random: Random) -> None:
    """Only how often each type occurs matters."""
    shuffled = [replace(node, op=f"my_{node.op}") for node in random.sample(graph.nodes, len(graph.nodes))]
    assert entropy(replace(graph, nodes=tuple(shuffled))) == entropy(graph)


@given(graphs())
def test_variation_ignores_the_unit(graph: Graph) -> None:
    """A coefficient of variation has no unit: twice as many channels everywhere vary as much."""
    doubled = replace(graph, channels=tuple(2 * channels for channels in graph.channels))
    assert variation(doubled) == variation(graph)


@given(graphs())
def test_added_connection_never_shortens(graph: Graph) -> None:
    """Connecting every pair gives density 1 and a path through every weighted node."""
    count = len(graph.nodes)
    full = replace(graph, edges=tuple((a, b) for b in range(count) for a in range(b)))
    assert density(full) == (1.0 if count > 1 else 0.0)
    assert depth(full) == max(1, sum(node.weighted for node in graph.nodes)) >= depth(graph)
