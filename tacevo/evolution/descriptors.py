"""The two behaviour descriptors of a network, computed from its traced graph by the paper's formulas.

Pure numbers: only `+ - * / sqrt` and `math.fsum`, which are correctly rounded everywhere, and `math.log2`, whose
last bit is not. Each result is therefore rounded to 12 significant digits, so that it may enter a ledger that is
compared byte for byte between machines. What counts as a node, an edge and a property stands in
docs/descriptors.md.
"""

import math
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from tacevo import parts
from tacevo.choices import Scale
from tacevo.profile import Graph, Profile


@dataclass(frozen=True, slots=True, kw_only=True)
class Descriptor:
    """The point of a network in behaviour space, with the parts whose mean is its first coordinate."""

    #: Architectural diversity, the mean of `entropy`, `density` and `variation`; >= 0.
    arch_div: float
    #: Compute efficiency, FLOPs / (parameters x width / depth); >= 0.
    eff_ratio: float
    #: Normalised entropy of the operation types, in [0, 1].
    entropy: float
    #: Connections over possible connections, in [0, 1].
    density: float
    #: Mean coefficient of variation of the layer properties; >= 0.
    variation: float


@dataclass(frozen=True)
class ArchDiv(parts.Descriptor):
    """Architectural diversity, as an axis of the network archive."""

    def describe(self, profile: Profile) -> float:
        """Return the mean of entropy, density and variation."""
        return describe(profile).arch_div


@dataclass(frozen=True)
class EffRatio(parts.Descriptor):
    """Compute efficiency, as an axis of the network archive."""

    eff_ratio_scale: Scale

    def describe(self, profile: Profile) -> float:
        """Return the Efficiency Ratio, as it is or as its logarithm (`scaled`)."""
        return scaled(describe(profile).eff_ratio, self.eff_ratio_scale)


def describe(profile: Profile) -> Descriptor:
    """Compute both descriptors of a probed network and the parts they are made of.

    What a network learns outside its parameters counts as parameters, so that nothing is gained by hiding it.

    Raises:
        ValueError: the profile has no parameters, so that efficiency is undefined.
    """
    if profile.parameters < 1:
        raise ValueError(f"profile.parameters must be >= 1; got {profile.parameters}")
    graph = profile.graph
    parts = (entropy(graph), density(graph), variation(graph))
    return Descriptor(
        arch_div=_rounded(math.fsum(parts) / 3),
        eff_ratio=_rounded(profile.flops * depth(graph) / (profile.learnt * width(graph))),
        entropy=parts[0],
        density=parts[1],
        variation=parts[2],
    )


def entropy(graph: Graph) -> float:
    """Measure how evenly the operation types are used.

    Returns:
        `-sum(p log2 p) / log2 N` over the N operation types, in [0, 1]; 0 for fewer than two types, where
        `log2 N` is 0 or undefined.
    """
    counts = Counter(node.op for node in graph.nodes)
    if len(counts) < 2:
        return 0.0
    shares = [count / len(graph.nodes) for count in counts.values()]
    bits = -math.fsum(share * math.log2(share) for share in shares)
    return _rounded(min(bits / math.log2(len(counts)), 1.0))


def density(graph: Graph) -> float:
    """Measure how densely the operations are connected.

    Returns:
        Edges over the `n (n - 1) / 2` pairs that an acyclic graph of n nodes can connect, in [0, 1]; 0 for
        fewer than two nodes.
    """
    pairs = len(graph.nodes) * (len(graph.nodes) - 1) // 2
    return _rounded(len(graph.edges) / pairs) if pairs else 0.0


def variation(graph: Graph) -> float:
    """Average the coefficients of variation of channels, kernel sizes and hidden widths.

    Returns:
        The mean over the properties that the network has; one without values is left out, a network with none
        gives 0, and so does a property whose values are all 0, where the mean cannot divide.
    """
    properties = [values for values in (graph.channels, graph.kernels, graph.hidden) if values]
    if not properties:
        return 0.0
    return _rounded(math.fsum(_coefficient_of_variation(values) for values in properties) / len(properties))


def depth(graph: Graph) -> int:
    """Count the weighted nodes on the path that has most of them; at least 1."""
    longest = [int(node.weighted) for node in graph.nodes]
    for producer, consumer in sorted(graph.edges, key=lambda edge: edge[1]):
        longest[consumer] = max(longest[consumer], longest[producer] + graph.nodes[consumer].weighted)
    return max([1, *longest])


def width(graph: Graph) -> int:
    """Find the output channels or features of the widest weighted node; at least 1."""
    return max([1, *(node.width for node in graph.nodes if node.weighted)])


def on_axis(axis: str, value: float, eff_ratio: Scale) -> float:
    """Return a descriptor as its axis of the archive has it: the scale is that of the Efficiency Ratio only."""
    return scaled(value, eff_ratio) if axis == "eff_ratio" else value


def scaled(eff_ratio: float, scale: Scale) -> float:
    """Return an Efficiency Ratio as the archive's axis has it: as it is, or its decimal logarithm.

    A network without counted FLOPs has ratio 0; on a logarithmic axis it stands at the smallest positive number.
    """
    if scale is Scale.linear:
        return eff_ratio
    return round(math.log10(max(eff_ratio, sys.float_info.min)), 12)


def _coefficient_of_variation(values: Sequence[float]) -> float:
    """Divide the population standard deviation by the mean; `values` are >= 0 and not empty."""
    mean = math.fsum(values) / len(values)
    if mean == 0:
        return 0.0
    return math.sqrt(math.fsum((value - mean) ** 2 for value in values) / len(values)) / mean


def _rounded(value: float) -> float:
    """Keep 12 significant digits: far more than a niche needs, and none that depends on the CPU."""
    return float(f"{value:.12g}")
