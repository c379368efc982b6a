"""The crossover of two networks of the grammar: a child of both."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tacevo.llm.grammar import wording
from tacevo.llm.grammar.bounds import fit
from tacevo.llm.grammar.network import Network
from tacevo.llm.grammar.variations import pick

_Way = Callable[[Network, Network, np.random.Generator], Network]

#: Draws until the child differs from both parents; alike parents may have no such child.
_ATTEMPTS = 6


def cross(first: Network, second: Network, instruction: str, rng: np.random.Generator) -> Network:
    """Join parts of two parents to a child within the bounds, which has the names and defaults of the first.

    The instruction may ask for the trunk of the first and the head of the second; else chance decides how they are
    joined and which of them leads. The child differs from both wherever six draws find such a one.
    """
    text = wording.operative(instruction)
    if wording.mentions(text, "trunk|backbone|features? ") and wording.mentions(text, "head|classifier|regressor"):
        return fit(_trunk_and_head(first, second, rng))
    child = first
    for _ in range(_ATTEMPTS):
        leader, other = pick(rng, ((first, second), (second, first)))
        joined = pick(rng, _WAYS)(leader, other, rng)
        child = fit(replace(joined, signature=first.signature))
        if child not in {first, second}:
            break
    return child


def _trunk_and_head(leader: Network, other: Network, rng: np.random.Generator) -> Network:
    """Take the trunk of one parent; the other gives the head with the pooling it was made for."""
    return replace(leader, head=other.head, pooling=other.pooling, grid=other.grid)


def _spliced(leader: Network, other: Network, rng: np.random.Generator) -> Network:
    """Take the early blocks of one parent and the late blocks of the other, with everything behind them."""
    cut = int(rng.integers(1, max(len(leader.blocks), 2)))
    late = other.blocks[cut:] or other.blocks[-1:]
    before = {skip for skip in leader.skips if skip[1] <= cut}
    behind = {skip for skip in other.skips if skip[0] >= cut}
    inherited = before | behind | (set(leader.skips) & set(other.skips))
    blocks = leader.blocks[:cut] + late
    return replace(other, blocks=blocks, skips=_within(inherited, len(blocks)))


def _mixed(leader: Network, other: Network, rng: np.random.Generator) -> Network:
    """Take each block and each other part from either parent; the depth is that of the leader."""
    blocks = tuple(
        pick(rng, (block, other.blocks[index])) if index < len(other.blocks) else block
        for index, block in enumerate(leader.blocks)
    )
    return replace(
        leader,
        blocks=blocks,
        skips=_within(pick(rng, (set(leader.skips), set(other.skips))), len(blocks)),
        attention=pick(rng, (leader.attention, other.attention)),
        pooling=pick(rng, (leader.pooling, other.pooling)),
        grid=pick(rng, (leader.grid, other.grid)),
        head=pick(rng, (leader.head, other.head)),
        block_module=pick(rng, (leader.block_module, other.block_module)),
    )


def _within(skips: set[tuple[int, int]], depth: int) -> tuple[tuple[int, int], ...]:
    return tuple(sorted(skip for skip in skips if skip[1] <= depth))


_WAYS: tuple[_Way, ...] = (_trunk_and_head, _spliced, _mixed)
