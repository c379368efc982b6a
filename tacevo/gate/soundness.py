"""Whether a probe's graph and steps are such as tracing gives: a candidate can write frames, too (parent side)."""

from tacevo.profile import Graph, Node, Profile, Step

#: Widths, channels and kernel sides are below this, so that their squares and sums stay exact or at least finite.
_TOO_LARGE = 2**53

#: How many steps of a pass are recorded, and how many operands of a step: more than any network that a person would
#: write has, and little enough that a record stays below a megabyte or two.
MOST_STEPS = 5_000

MOST_OPERANDS = 16

#: Longest spelling of an operation; those of torch stay below 50 characters.
_LONGEST_NAME = 100


def is_sound_graph(graph: Graph) -> bool:
    """Check that a graph has sane nodes, forward edges, and a layer's properties for a node.

    Raises:
        TypeError: a field is of a type that cannot even be looked at.
    """
    layers = (*graph.channels, *graph.hidden)
    ends = [end for edge in graph.edges for end in edge]
    return (
        all(_is_sound_node(node) for node in graph.nodes)
        and all(type(end) is int for end in ends)
        and all(0 <= producer < consumer < len(graph.nodes) for producer, consumer in graph.edges)
        and len(set(graph.edges)) == len(graph.edges)
        and max(len(layers), len(graph.kernels)) <= len(graph.nodes)
        and all(_is_size(value) for value in layers)
        and all(type(side) in (int, float) and 0 <= side < _TOO_LARGE for side in graph.kernels)
    )


def are_sound_steps(profile: Profile) -> bool:
    """Check that steps lead forwards, and that their sizes are sizes; raises as `is_sound_graph` does."""
    return (
        len(profile.steps) <= MOST_STEPS
        and all(_is_sound_step(step, index) for index, step in enumerate(profile.steps))
        and _are_rising(profile.output, below=len(profile.steps))
    )


def _is_sound_node(node: Node) -> bool:
    return _is_name(node.op) and type(node.weighted) is bool and _is_size(node.width)


def _is_sound_step(step: Step, index: int) -> bool:
    sizes = (*step.shape, *step.kernel, *step.stride, step.groups, *(size for shape in step.operands for size in shape))
    return (
        _is_name(step.op)
        and type(step.weighted) is bool
        and len(step.sources) == len(step.operands) <= MOST_OPERANDS
        and all(_are_rising(sources, below=index) for sources in step.sources)
        and all(_is_size(size) for size in sizes)
        and type(step.rate) in (int, float)
        and 0 <= step.rate <= 1
    )


def _are_rising(indices: tuple[int, ...], *, below: int) -> bool:
    return all(type(index) is int and 0 <= index < below for index in indices) and list(indices) == sorted(set(indices))


def _is_name(value: object) -> bool:
    return type(value) is str and len(value) <= _LONGEST_NAME


def _is_size(value: object) -> bool:
    return type(value) is int and 0 <= value < _TOO_LARGE
