"""Instructions about the trunk: each rule reads one kind of change from the words and makes it.

A rule returns None where the words do not concern it. Where they name no block, it acts on every block.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np

from tacevo.llm.grammar import moves, wording
from tacevo.llm.grammar.bounds import fit
from tacevo.llm.grammar.network import Attention, Block, Down, Network, Norm, Output, Pooling
from tacevo.llm.grammar.variations import CHEAPER, STRONGER, vary, warm


def channels(text: str, network: Network) -> Network | None:
    """Widen or narrow blocks, by a factor or to a number."""
    which = _named_or_all(text, network)
    number = re.search(r"(\d+) (?:output )?(?:channels|filters)", text)
    if number:
        return moves.set_blocks(network, which, channels=int(number[1]))
    if not wording.mentions(text, r"channels?\b|filters?\b|widen|wider|narrow"):
        return None
    factor = wording.scale(text)
    if factor is None and wording.mentions(text, r"widen|wider conv|more (?:\w+ )?(?:channels|filters)"):
        factor = 1.25
    if factor is None and wording.mentions(text, r"narrow|fewer (?:\w+ )?(?:channels|filters)"):
        factor = 0.75
    return moves.scale_channels(network, factor, which) if factor else None


def kernel(text: str, network: Network) -> Network | None:
    """Change the kernel of blocks; a 1x1 kernel asks for one more block that mixes channels."""
    size = wording.kernel_size(text)
    pointwise = wording.mentions(text, "pointwise") and not wording.mentions(text, "depthwise")
    if size == 1 or pointwise:
        return _add_pointwise(text, network)
    if size is None or size % 2 == 0 or not wording.mentions(text, r"kernel|conv|filter"):
        return None
    return moves.set_blocks(network, _named_or_all(text, network), kernel=size)


def separable(text: str, network: Network) -> Network | None:
    """Make convolutions depthwise separable."""
    if not wording.mentions(text, r"depth-?wise|separable"):
        return None
    return moves.separate(network, _named_or_all(text, network))


def norm(text: str, network: Network) -> Network | None:
    """Add a batch or group normalisation to blocks, or take it away."""
    batch, group = r"batch[ -]?norm", r"group[ -]?norm"
    if not wording.mentions(text, f"{batch}|{group}"):
        return None
    wanted = Norm.batch if wording.mentions(text, batch) and not wording.gives_up(text, batch) else Norm.group
    if wording.removes(text, f"{batch}|{group}"):
        wanted = Norm.none
    return moves.set_blocks(network, _named_or_all(text, network), norm=wanted)


def activation(text: str, network: Network) -> Network | None:
    """Exchange the activations, in the trunk or the head alone where the words say so."""
    wanted = wording.activation(text)
    if wanted is None:
        return None
    blocks = wording.named_blocks(text, len(network.blocks))
    if blocks:
        return moves.set_blocks(network, blocks, activation=wanted)
    head_only = wording.mentions(text, "head") and not wording.mentions(text, "conv|trunk|everywhere|network")
    trunk_only = wording.mentions(text, "conv|trunk") and not wording.mentions(text, "head|everywhere|network")
    return moves.set_activation(network, wanted, trunk=not head_only, head=not trunk_only)


def downsampling(text: str, network: Network) -> Network | None:
    """Exchange how the blocks halve the map."""
    if wording.mentions(text, "strid"):
        return moves.set_downsampling(network, Down.stride)
    if wording.mentions(text, "adaptive|global"):
        return None
    average = wording.mentions(text, r"(?:average|avg)[ -]?pool")
    if average and not wording.gives_up(text, "average|avg"):
        return moves.set_downsampling(network, Down.average)
    if average or wording.mentions(text, r"max(?:imum)?[ -]?pool"):
        return moves.set_downsampling(network, Down.max)
    return None


def attention(text: str, network: Network) -> Network | None:
    """Add attention before the adaptive pooling, or inside blocks where the words name them; or take it away."""
    pattern = r"\w*-?attention|attend|squeeze"
    if not wording.mentions(text, pattern):
        return None
    if wording.removes(text, rf"(?:\w+ )?{pattern}"):
        return replace(moves.set_blocks(network, attention=Attention.none), attention=Attention.none)
    channel = wording.mentions(text, "channel|squeeze") and not wording.mentions(text, "spatial")
    wanted = Attention.channel if channel else Attention.spatial
    if wording.mentions(text, r"(?:before|ahead of) (?:the )?(?:adaptive|global|pool|head)|last|final"):
        return replace(network, attention=wanted)
    blocks = wording.named_blocks(text, len(network.blocks))
    if not blocks and wording.mentions(text, r"(?:each|every|all|the)(?: \w+)? (?:block|stage)s?"):
        blocks = list(moves.all_blocks(network))
    if blocks:
        return moves.set_blocks(network, blocks, attention=wanted)
    return replace(network, attention=wanted)


def skip(text: str, network: Network) -> Network | None:
    """Add a residual connection between or around the blocks named, or take all away."""
    pattern = "residual|skip|shortcut|bypass"
    if not wording.mentions(text, pattern):
        return None
    if wording.removes(text, pattern):
        return replace(network, skips=())
    named = wording.named_blocks(text, len(network.blocks)) or _first_not_bypassed(network)
    source = named[0] if len(named) > 1 else named[0] - 1
    return moves.add_skip(network, source, named[-1])


def block_module(text: str, network: Network) -> Network | None:
    """Express the blocks by one custom module."""
    module = wording.mentions(text, r"module|class") and wording.mentions(text, r"custom|reus|own|refactor|express")
    if not module or not wording.mentions(text, r"block|stage|pattern") or wording.mentions(text, "head|attention"):
        return None
    return replace(network, block_module=True)


def _named_or_all(text: str, network: Network) -> list[int]:
    return wording.named_blocks(text, len(network.blocks)) or list(moves.all_blocks(network))


def _add_pointwise(text: str, network: Network) -> Network:
    """Add a 1x1 block, in the style of the block it follows."""
    after = (wording.named_blocks(text, len(network.blocks)) or [len(network.blocks)])[-1]
    model = network.blocks[after - 1]
    block = Block(channels=model.channels, kernel=1, norm=model.norm, activation=model.activation)
    return moves.insert_block(network, after, block)


def _first_not_bypassed(network: Network) -> list[int]:
    """Find the first block behind conv1 without a residual connection of its own; else the last block."""
    free = [number for number in moves.all_blocks(network)[1:] if (number - 1, number) not in network.skips]
    return free[:1] or [len(network.blocks)]


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
        if not wording.mentions(text, "head"):
            network = moves.set_blocks(network, dropout=0.0)
        return moves.remove_head_dropout(network)
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
            bound = Output.free if wording.removes(text, pattern) else wanted
            return moves.set_head(network, output=bound)
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
    return moves.set_head(network, own_module=True)


def lighter(text: str, network: Network) -> Network | None:
    """Halve the hidden layers."""
    if not wording.mentions(text, "head") or not wording.mentions(text, "light|slim|small|lean"):
        return None
    return moves.scale_hidden(network, 0.5)


_Rule = Callable[[str, Network], Network | None]

_RULES: tuple[_Rule, ...] = (
    channels,
    kernel,
    separable,
    norm,
    activation,
    downsampling,
    attention,
    skip,
    block_module,
    hidden,
    dropout,
    layer_norm,
    output,
    pooling,
    own_module,
    lighter,
)


def transform(network: Network, instruction: str, rng: np.random.Generator, temperature: float) -> Network:
    """Change a network as an instruction says, and a little more the warmer the temperature in [0, 1] is.

    The child is within the bounds, and equal to the parent where that has already what is asked for.
    """
    return warm(follow(network, instruction, rng), temperature, rng)


def follow(network: Network, instruction: str, rng: np.random.Generator) -> Network:
    """Apply every rule that the words call for; where they call for none, take a move towards their aim."""
    changed = _by_rules(network, instruction)
    return _aim(network, wording.operative(instruction), rng) if changed is None else changed


@lru_cache(maxsize=4096)  # a space asks again until something has changed, and parents are asked for the same
def _by_rules(network: Network, instruction: str) -> Network | None:
    """Apply every rule that the words call for; None where they call for none."""
    text = wording.operative(instruction)
    called = False
    for rule in _RULES:
        changed = rule(text, network)
        if changed is not None:
            network, called = fit(changed), True
    return network if called else None


def _aim(network: Network, text: str, rng: np.random.Generator) -> Network:
    """Follow an instruction that names a goal instead of a change."""
    if wording.mentions(text, r"trade|\w*balanc"):
        return vary(vary(network, CHEAPER, rng), STRONGER, rng)
    if wording.mentions(text, r"fast|cheap|speed|latency|inference|light|shrink|fewer|parameter|compact"):
        return vary(network, CHEAPER, rng)
    return vary(network, STRONGER, rng)
