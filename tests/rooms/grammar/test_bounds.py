"""Networks are counted exactly and kept to a size that trains."""

from dataclasses import replace

from grammar_strategies import SIGNATURE, build, networks, train_a_step
from hypothesis import given

from tacevo.llm.grammar.bounds import MAX_COST, MAX_PARAMETERS, cost, fit, parameters
from tacevo.llm.grammar.network import Block, Down, Head, Hidden, Network, Output
from tacevo.llm.grammar.rendering import render

BASELINE = Network(
    signature=SIGNATURE,
    blocks=tuple(Block(channels=channels, down=Down.max) for channels in (32, 64, 128)),
    head=Head(hidden=(Hidden(width=512, dropout=0.5),)),
)


def test_baseline_counts_are_those_worked_out_by_hand() -> None:
    """Parameters of each layer, weights and biases; multiply-adds of each convolution at its resolution."""
    convolutions = (27 * 32 + 32) + (9 * 32 * 64 + 64) + (9 * 64 * 128 + 128)
    head = (2048 * 512 + 512) + (512 * 3 + 3)
    assert parameters(BASELINE) == convolutions + head
    assert cost(BASELINE) == 27 * 32 + 9 * 32 * 64 / 4 + 9 * 64 * 128 / 16


def test_strided_convolution_pays_for_a_quarter_of_the_positions() -> None:
    """A pooling layer halves the map behind its convolution, a stride already in it."""
    strided = tuple(replace(block, down=Down.stride) for block in BASELINE.blocks)
    assert cost(replace(BASELINE, blocks=strided)) == cost(BASELINE) / 4


@given(networks())
def test_fitted_networks_train_at_32_pixels_and_are_counted_exactly(network: Network) -> None:
    """One forward and one backward pass; torch counts the parameters that we count; outputs have their shape."""
    fitted = replace(fit(network), head=replace(fit(network).head, output=Output.free))
    module = build(render(fitted), fitted.signature.class_name)
    assert sum(parameter.numel() for parameter in module.parameters()) == parameters(fitted)
    outputs = train_a_step(module, fitted.signature.in_channels, image_size=32)
    assert outputs.shape == (2, fitted.signature.outputs)


@given(networks())
def test_what_is_within_the_bounds_stays_as_it_is(network: Network) -> None:
    """So does the baseline, from which a search starts."""
    assert fit(fit(network)) == fit(network)
    assert fit(BASELINE) == BASELINE


def test_a_huge_network_is_narrowed_until_it_fits() -> None:
    """Neither the parameters nor the multiply-adds of a pixel stay above their limits."""
    block = Block(channels=512, kernel=7)
    huge = replace(BASELINE, blocks=(block,) * 6, grid=8, head=Head(hidden=(Hidden(width=2048),) * 4))
    assert parameters(fit(huge)) <= MAX_PARAMETERS
    assert cost(fit(huge)) <= MAX_COST
    widths = [block.channels for block in fit(huge).blocks], [layer.width for layer in fit(huge).head.hidden]
    assert widths == ([12] * 6, [56] * 4)
    assert {type(width) for each in widths for width in each} == {int}


def test_what_cannot_be_narrowed_further_is_left_to_the_gate() -> None:
    """A task with millions of outputs is beyond the bounds at any width; fitting ends all the same."""
    narrowest = fit(replace(BASELINE, signature=replace(SIGNATURE, outputs=10_000_000)))
    assert parameters(narrowest) > MAX_PARAMETERS
    assert {layer.width for layer in narrowest.head.hidden} == {16}


def test_a_fifth_halving_is_given_up() -> None:
    """A 32-pixel image keeps 2 x 2 positions."""
    deep = replace(BASELINE, blocks=tuple(Block(channels=8, down=Down.stride) for _ in range(6)))
    assert [block.down for block in fit(deep).blocks] == [Down.stride] * 4 + [Down.none] * 2


def test_surplus_blocks_take_their_skips_along() -> None:
    """A skip to a block that is dropped is dropped with it."""
    long = replace(BASELINE, blocks=tuple(Block(channels=8) for _ in range(8)), skips=((1, 3), (5, 8)))
    assert (len(fit(long).blocks), fit(long).skips) == (6, ((1, 3),))
