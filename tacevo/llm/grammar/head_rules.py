"""Instructions about the head: each rule reads one kind of change from the words and makes it.

A rule returns None where the words do not concern it.
"""

from dataclasses import replace

from tacevo.llm.grammar import moves, wording
from tacevo.llm.grammar.network import Network, Output, Pooling

_MORE = r"extra|another|additional|further|second|third|fourth|one more|add"


def hidden(text: str, network: Network) -> Network | None:
    """Resize the hidden layer, or add or drop one."""
    pattern = r"hidden[ -](?:layer|unit|width|size)"
    if not wording.mentions(text, pattern):
        return None
    width, factor = wording.whole_number(text), wording.scale(text)
    if wording.removes(text, pattern):
        return moves.drop_hidden(network)
    if wording.mentions(text, rf"(?:{_MORE})\b(?: \w+){{0,3}} hidden"):
        return moves.add_hidden(network, width or 256)
    if width:
        return moves.set_hidden(network, width)
    return moves.scale_hidden(network, factor) if factor else None


def dropout(text: str, network: Network) -> Network | None:
    """Remove the dropout, add one, or set its rate."""
    if not wording.mentions(text, "dropout"):
        return None
    rate = wording.probability(text)
    if wording.removes(text, "dropout"):
        head_only = wording.mentions(text, "head")
        return moves.remove_head_dropout(network) if head_only else moves.remove_dropout(network)
    if wording.mentions(text, rf"(?:{_MORE})\b(?: \w+){{0,3}} dropout"):
        return moves.add_dropout(network, rate or 0.25)
    return moves.set_dropout(network, rate) if rate else None


def layer_norm(text: str, network: Network) -> Network | None:
    """Add a LayerNorm before the activation of every hidden layer, or take them away."""
    pattern = r"layer[ -]?norm"
    if not wording.mentions(text, pattern):
        return None
    wanted = not wording.removes(text, pattern)
    return moves.edit_hidden(network, lambda layer: replace(layer, layer_norm=wanted))


def output(text: str, network: Network) -> Network | None:
    """Bound the outputs by an activation, or free them."""
    names = {
        r"hard[ -]?tanh": Output.hardtanh,
        r"tanh": Output.tanh,
        r"sigmoid": Output.sigmoid,
        r"soft[ -]?max": Output.softmax,
    }
    for pattern, wanted in names.items():
        if wording.mentions(text, pattern) and not wording.mentions(text, "attention"):
            return moves.set_output(network, Output.free if wording.removes(text, pattern) else wanted)
    return None


def pooling(text: str, network: Network) -> Network | None:
    """Choose the adaptive pooling: average, maximum, or both side by side."""
    average = wording.mentions(text, "average|avg")
    maximum = wording.mentions(text, "max")
    if not wording.mentions(text, "adaptive|global") or not (average or maximum):
        return None
    joined = wording.mentions(text, "join|combin|concat|both|merg|side by side")
    given_up = wording.gives_up(text, "(?:adaptive |global )?(?:average|avg)")
    if average and maximum and (joined or not wording.gives_up(text, "(?:adaptive |global )?(?:average|avg|max)")):
        return replace(network, pooling=Pooling.both)
    return replace(network, pooling=Pooling.average if average and not given_up else Pooling.max)


def own_module(text: str, network: Network) -> Network | None:
    """Make the head a class of its own."""
    module = wording.mentions(text, r"(?:sub)?module|class\b|nn\.module") and wording.mentions(
        text, "own|separate|custom|dedicated|independent"
    )
    if not module or not wording.mentions(text, "head") or wording.mentions(text, "attention"):
        return None
    return replace(network, head=replace(network.head, own_module=True))


def lighter(text: str, network: Network) -> Network | None:
    """Halve the hidden layers."""
    if not wording.mentions(text, "head") or not wording.mentions(text, "light|slim|small|lean"):
        return None
    return moves.scale_hidden(network, 0.5)
