"""A child of two parents holds parts of both, fits together, and bears the first parent's names."""

from dataclasses import replace

from grammar_strategies import SIGNATURE, networks
from hypothesis import given
from hypothesis import strategies as st

from tacevo.llm.grammar.bounds import fit
from tacevo.llm.grammar.crossover import cross
from tacevo.llm.grammar.network import Activation, Block, Down, Head, Hidden, Network, Pooling
from tacevo.randomness import stream

FIRST = Network(
    signature=SIGNATURE,
    blocks=tuple(Block(channels=channels, down=Down.max) for channels in (32, 64, 128)),
    skips=((1, 3),),
    head=Head(hidden=(Hidden(width=512, dropout=0.5),)),
)
SECOND = Network(
    signature=SIGNATURE,
    blocks=tuple(
        Block(channels=channels, kernel=5, activation=Activation.gelu, down=Down.stride)
        for channels in (16, 24, 40, 48)
    ),
    skips=((0, 1), (3, 4)),
    pooling=Pooling.max,
    grid=2,
    head=Head(hidden=(Hidden(width=64), Hidden(width=32)), own_module=True),
)


def test_trunk_of_the_first_and_head_of_the_second_on_request() -> None:
    """The pooling goes with the head that was made for it."""
    child = cross(FIRST, SECOND, "Join the trunk of the first parent to the head of the second.", stream(0))
    assert (child.blocks, child.skips) == (FIRST.blocks, FIRST.skips)
    assert (child.head, child.pooling, child.grid) == (SECOND.head, SECOND.pooling, SECOND.grid)


def test_every_part_comes_from_a_parent() -> None:
    """Crossing invents nothing: blocks, head and pooling are those of one parent or the other, names the first's."""
    renamed = replace(SECOND, signature=replace(SIGNATURE, head_name="head"))
    for seed in range(40):
        child = cross(FIRST, renamed, "Combine both.", stream(seed))
        assert set(child.blocks) <= {*FIRST.blocks, *SECOND.blocks}
        assert child.head in {FIRST.head, SECOND.head}
        assert child.grid in {2, 4}
        assert child.signature == SIGNATURE


def test_children_of_different_parents_differ_from_both() -> None:
    """In a hundred draws none is a mere copy, and they are of many kinds."""
    children = [cross(FIRST, SECOND, "Combine both.", stream(seed)) for seed in range(100)]
    assert FIRST not in children
    assert SECOND not in children
    assert len(set(children)) > 30


def test_child_of_equal_parents_is_like_them() -> None:
    """Where there is nothing to combine, the parent comes back."""
    assert cross(FIRST, FIRST, "Combine both.", stream(0)) == FIRST


@given(networks(), networks(), st.integers(0, 10_000))
def test_children_stay_within_the_bounds(first: Network, second: Network, seed: int) -> None:
    """Skips included: parents of different depth never leave one that leads nowhere."""
    child = cross(first, second, "Combine both.", stream(seed))
    assert fit(child) == child
