"""Traced graphs drawn by hand, for networks whose input is a 3 x 8 x 8 image; each network stands beside its graph.

test_trace.py checks that tracing the network gives the graph, test_descriptors.py computes from the graph.
"""

from tacevo.profile import Graph, Node


def _conv(width: int) -> Node:
    return Node(op="conv2d", weighted=True, width=width)


def _linear(width: int) -> Node:
    return Node(op="linear", weighted=True, width=width)


def _plain(op: str) -> Node:
    return Node(op=op, weighted=False, width=0)


#: conv 3x3 to 4 - ReLU - max pool - conv 5x5 to 8 - flatten - linear to 6 - ReLU - linear to 3
CHAIN = Graph(
    nodes=(_conv(4), _plain("max_pool2d"), _conv(8), _linear(6), _linear(3)),
    edges=((0, 1), (1, 2), (2, 3), (3, 4)),
    channels=(4, 8),
    kernels=(3.0, 5.0),
    hidden=(6,),
)

#: h = conv 3x3 to 4; h + conv 3x3 to 4 (h); global average pool; linear to 3
RESIDUAL = Graph(
    nodes=(_conv(4), _conv(4), _plain("add"), _plain("adaptive_avg_pool2d"), _linear(3)),
    edges=((0, 1), (0, 2), (1, 2), (2, 3), (3, 4)),
    channels=(4, 4),
    kernels=(3.0, 3.0),
    hidden=(),
)

#: conv 1x1 to 4 beside conv 3x3 to 8; concatenated; mean over the image; linear to 3
BRANCH = Graph(
    nodes=(_conv(4), _conv(8), _plain("cat"), _plain("mean"), _linear(3)),
    edges=((0, 2), (1, 2), (2, 3), (3, 4)),
    channels=(4, 8),
    kernels=(1.0, 3.0),
    hidden=(),
)

#: conv 3x3 to 4; one other conv 3x3 to 4 called twice; mean; linear to 3
SHARED = Graph(
    nodes=(_conv(4), _conv(4), _conv(4), _plain("mean"), _linear(3)),
    edges=((0, 1), (1, 2), (2, 3), (3, 4)),
    channels=(4, 4),
    kernels=(3.0, 3.0),
    hidden=(),
)

#: flatten; linear to 3
ONE_LAYER = Graph(nodes=(_linear(3),), edges=(), channels=(), kernels=(), hidden=())

#: mean over the image; einsum with a 3 x 5 parameter; linear to 3
EINSUM = Graph(
    nodes=(_plain("mean"), Node(op="einsum", weighted=True, width=5), _linear(3)),
    edges=((0, 1), (1, 2)),
    channels=(),
    kernels=(),
    hidden=(),
)

#: conv 3x3 to 4; conv 3x3 to 12; global average pool; linear to 3
NO_HIDDEN_LAYER = Graph(
    nodes=(_conv(4), _conv(12), _plain("adaptive_avg_pool2d"), _linear(3)),
    edges=((0, 1), (1, 2), (2, 3)),
    channels=(4, 12),
    kernels=(3.0, 3.0),
    hidden=(),
)
