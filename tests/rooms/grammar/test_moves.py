"""Moves keep a network whole: blocks, skips and dropouts end up where they belong."""

from collections.abc import Callable
from dataclasses import replace

import pytest
from grammar_strategies import SIGNATURE

from tacevo.llm.grammar import moves
from tacevo.llm.grammar.network import Block, Down, Head, Hidden, Network

CHAIN = Network(
    signature=SIGNATURE,
    blocks=tuple(Block(channels=channels, down=Down.max) for channels in (8, 16, 24, 32)),
    skips=((0, 2), (2, 4)),
    head=Head(hidden=(Hidden(width=64, dropout=0.5),)),
)


def test_inserted_block_leaves_skips_at_their_blocks() -> None:
    """The blocks behind the new one change their numbers, and the skips follow."""
    grown = moves.insert_block(CHAIN, 2, Block(channels=99))
    assert [block.channels for block in grown.blocks] == [8, 16, 99, 24, 32]
    assert grown.skips == ((0, 2), (2, 5))


def test_dropped_block_takes_its_skips_along() -> None:
    """Skips that neither begin nor end there go on joining the blocks they joined."""
    assert moves.drop_block(CHAIN, 3).skips == ((0, 2), (2, 3))
    assert moves.drop_block(CHAIN, 2).skips == ()


def test_moves_stop_at_the_bounds() -> None:
    """Two blocks are the fewest, six the most, and so are four hidden layers."""
    short = moves.drop_block(moves.drop_block(CHAIN, 4), 3)
    full = replace(CHAIN, blocks=(*CHAIN.blocks, *CHAIN.blocks[:2]), head=Head(hidden=CHAIN.head.hidden * 4))
    assert moves.drop_block(short, 1) == short
    assert moves.insert_block(full, 1, Block(channels=8)) == moves.add_hidden(full, 32) == full


def test_added_dropouts_take_the_free_places_in_turn() -> None:
    """First the hidden layers, then the input of the head, then the blocks from the last on, at half the rate."""
    once = moves.add_dropout(moves.add_hidden(CHAIN, 32), 0.2)
    twice = moves.add_dropout(once, 0.2)
    thrice = moves.add_dropout(twice, 0.2)
    assert [layer.dropout for layer in once.head.hidden] == [0.5, 0.2]
    assert twice.head.input_dropout == 0.2
    assert [block.dropout for block in thrice.blocks] == [0.0, 0.0, 0.0, 0.1]


def test_dropout_rate_of_a_head_without_any_adds_one() -> None:
    """A rate that is asked for is there afterwards."""
    bare = moves.remove_head_dropout(CHAIN)
    assert moves.set_dropout(bare, 0.6).head.hidden[-1].dropout == 0.6
    no_hidden = replace(bare, head=Head(hidden=()))
    assert moves.set_dropout(no_hidden, 0.6).head.input_dropout == 0.6


def test_downsampling_changes_only_blocks_that_halve() -> None:
    """A block that keeps the size of its map goes on keeping it."""
    mixed = moves.insert_block(CHAIN, 4, Block(channels=8))
    changed = moves.set_downsampling(mixed, Down.stride)
    assert [block.down for block in changed.blocks] == [Down.stride] * 4 + [Down.none]


def test_skips_are_kept_distinct_and_in_order() -> None:
    """The same connection twice is one, and a fifth is refused."""
    assert moves.add_skip(CHAIN, 1, 2).skips == ((0, 2), (1, 2), (2, 4))
    assert moves.add_skip(CHAIN, 2, 4) == CHAIN
    full = moves.add_skip(moves.add_skip(CHAIN, 1, 2), 0, 1)
    assert moves.add_skip(full, 3, 4) == full


def test_head_without_hidden_layer_gets_one_of_the_width_asked_for() -> None:
    """Setting a width never passes silently."""
    assert moves.set_hidden(replace(CHAIN, head=Head(hidden=())), 128).head.hidden == (Hidden(width=128),)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: replace(CHAIN, skips=((3, 2),)), r"forward within 4 blocks; got \(\(3, 2\),\)"),
        (lambda: replace(CHAIN, skips=((2, 4), (0, 2))), "distinct and in order"),
        (lambda: Block(channels=8, kernel=4), "odd; got 4"),
        (lambda: replace(CHAIN, blocks=(), skips=()), "at least one block"),
    ],
)
def test_network_that_cannot_be_written_is_refused(build: Callable[[], object], message: str) -> None:
    """Data flow forward, equal networks have equal records, and each kernel can be padded."""
    with pytest.raises(ValueError, match=message):
        build()
