"""From the words of an instruction to a changed network."""

from collections.abc import Callable

import numpy as np

from tacevo.llm.grammar import head_rules, trunk_rules, wording
from tacevo.llm.grammar.bounds import fit
from tacevo.llm.grammar.network import Network
from tacevo.llm.grammar.variations import CHEAPER, STRONGER, vary, warm

_Rule = Callable[[str, Network], Network | None]

_RULES: tuple[_Rule, ...] = (
    trunk_rules.channels,
    trunk_rules.kernel,
    trunk_rules.separable,
    trunk_rules.norm,
    trunk_rules.activation,
    trunk_rules.downsampling,
    trunk_rules.attention,
    trunk_rules.skip,
    trunk_rules.block_module,
    head_rules.hidden,
    head_rules.dropout,
    head_rules.layer_norm,
    head_rules.output,
    head_rules.pooling,
    head_rules.own_module,
    head_rules.lighter,
)


def transform(network: Network, instruction: str, rng: np.random.Generator, temperature: float) -> Network:
    """Change a network as an instruction says, and a little more the warmer it is.

    Args:
        network: the parent.
        instruction: one or a few sentences in English.
        rng: settles what the instruction leaves open, and the extra edits.
        temperature: in [0, 1]; at 0 the instruction alone acts.

    Returns:
        The child, within the bounds of `bounds.py`; equal to the parent where it has already what is asked for.
    """
    return warm(follow(network, instruction, rng), temperature, rng)


def follow(network: Network, instruction: str, rng: np.random.Generator) -> Network:
    """Apply every rule that the words call for; where they call for none, take a move towards their aim."""
    text = wording.operative(instruction)
    called = False
    for rule in _RULES:
        changed = rule(text, network)
        if changed is not None:
            network, called = fit(changed), True
    return network if called else _aim(network, text, rng)


def _aim(network: Network, text: str, rng: np.random.Generator) -> Network:
    """Follow an instruction that names a goal instead of a change."""
    if wording.mentions(text, r"trade|\w*balanc"):
        return vary(vary(network, CHEAPER, rng), STRONGER, rng)
    if wording.mentions(text, r"fast|cheap|speed|latency|inference|light|shrink|fewer|parameter|compact"):
        return vary(network, CHEAPER, rng)
    return vary(network, STRONGER, rng)
