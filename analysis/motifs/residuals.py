"""Residual connections by what they do: an addition past layers (definitions: docs/motifs.md)."""

from collections.abc import Set

from analysis.motifs.step_graph import Flow


def find_shortcuts(flow: Flow) -> tuple[tuple[int, int], ...]:
    """Find every residual connection.

    Args:
        flow: the network without its gates, so that `x + x * gate(x)` is not one.

    Returns:
        (addition, number of the operand that is the shortcut), in the order of the calls.
    """
    found = ((index, _shortcut(flow, index)) for index in sorted(flow.live))
    return tuple((index, number) for index, number in found if number is not None)


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
