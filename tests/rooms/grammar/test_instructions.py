"""Every instruction of the three libraries makes its change, and other wordings of it do so too."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import yaml
from checkout import LIBRARY
from grammar_strategies import networks
from hypothesis import given
from hypothesis import strategies as st

from tacevo.llm.grammar.bounds import cost, fit, parameters
from tacevo.llm.grammar.instructions import follow, transform
from tacevo.llm.grammar.network import Activation, Attention, Block, Down, Hidden, Network, Norm, Output, Pooling
from tacevo.llm.grammar.parsing import parse
from tacevo.llm.grammar.variations import vary
from tacevo.randomness import stream

TASKS = ("force", "grating", "hardness", "shape")
BASELINES = {task: parse((LIBRARY / task / "baseline.py").read_text()) for task in TASKS}
TEXTS: dict[tuple[str, str], str] = {
    (task, mutation["id"]): mutation["text"]
    for task in TASKS
    for mutation in yaml.safe_load((LIBRARY / task / "instructions.yaml").read_text())["mutations"]
}

Edit = Callable[[Network], Network]


def _blocks(**changes: object) -> Edit:
    """Change every block in the same way."""
    return lambda network: replace(network, blocks=tuple(replace(block, **changes) for block in network.blocks))  # type: ignore[arg-type]


def _block(number: int, **changes: object) -> Edit:
    """Change one block, counted from 1."""

    def edit(network: Network) -> Network:
        blocks = list(network.blocks)
        blocks[number - 1] = replace(blocks[number - 1], **changes)  # type: ignore[arg-type]
        return replace(network, blocks=tuple(blocks))

    return edit


def _hidden(*layers: Hidden) -> Edit:
    return lambda network: replace(network, head=replace(network.head, hidden=layers))


def _output(output: Output) -> Edit:
    return lambda network: replace(network, head=replace(network.head, output=output))


def _channels(*channels: int) -> Edit:
    def edit(network: Network) -> Network:
        pairs = zip(network.blocks, channels, strict=True)
        return replace(network, blocks=tuple(replace(block, channels=width) for block, width in pairs))

    return edit


def _activation(activation: Activation) -> Edit:
    return lambda network: _hidden(replace(BASE_HIDDEN, activation=activation))(_blocks(activation=activation)(network))


BASE_HIDDEN = Hidden(width=512, dropout=0.5)

#: What each instruction makes of its baseline; the same id means the same in every library.
CHANGES: dict[str, Edit] = {
    "widen_all": _channels(40, 80, 160),
    "widen_conv2": _channels(32, 80, 128),
    "halve_early": _channels(16, 32, 128),
    "hidden_1024": _hidden(replace(BASE_HIDDEN, width=1024)),
    "hidden_384": _hidden(replace(BASE_HIDDEN, width=384)),
    "extra_hidden": _hidden(BASE_HIDDEN, Hidden(width=256)),
    "second_hidden": _hidden(BASE_HIDDEN, Hidden(width=256)),
    "drop_dropout": _hidden(Hidden(width=512)),
    "dropout_06": _hidden(Hidden(width=512, dropout=0.6)),
    "lighter_head": _hidden(Hidden(width=256)),
    "layer_norm_head": _hidden(replace(BASE_HIDDEN, layer_norm=True)),
    "more_dropout": lambda network: replace(network, head=replace(network.head, input_dropout=0.25)),
    "leaky_relu": _activation(Activation.leaky_relu),
    "gelu": _activation(Activation.gelu),
    "kernel7_conv1": _block(1, kernel=7),
    "kernel5_conv3": _block(3, kernel=5),
    "separable_conv3": _block(3, separable=True),
    "strided": _blocks(down=Down.stride),
    "average_pooling": _blocks(down=Down.average),
    "batch_norm": _blocks(norm=Norm.batch),
    "norms": lambda network: _hidden(replace(BASE_HIDDEN, layer_norm=True))(_blocks(norm=Norm.batch)(network)),
    "spatial_attention": lambda network: replace(network, attention=Attention.spatial),
    "residual_1_3": lambda network: replace(network, skips=((1, 3),)),
    "residual_conv2": lambda network: replace(network, skips=((1, 2),)),
    "sigmoid_output": _output(Output.sigmoid),
    "tanh_output": _output(Output.tanh),
    "hardtanh_output": _output(Output.hardtanh),
    "softmax_output": _output(Output.softmax),
    "average_and_max": lambda network: replace(network, pooling=Pooling.both),
    "head_module": lambda network: replace(network, head=replace(network.head, own_module=True)),
    "block_module": lambda network: replace(network, block_module=True),
    "pointwise": lambda network: replace(network, blocks=(*network.blocks, Block(channels=128, kernel=1))),
}
OPEN_ENDED = ("refine", "rebalance", "faster")


@pytest.mark.parametrize(("task", "name"), [key for key in TEXTS if key[1] not in OPEN_ENDED])
def test_instruction_makes_exactly_its_change(task: str, name: str) -> None:
    """At temperature 0 the child is the baseline with what the instruction asks for, and nothing else."""
    child = transform(BASELINES[task], TEXTS[task, name], stream(0, name), temperature=0.0)
    assert child == CHANGES[name](BASELINES[task])


@pytest.mark.parametrize(("task", "name"), [key for key in TEXTS if key[1] in OPEN_ENDED])
def test_open_instruction_always_changes_something(task: str, name: str) -> None:
    """Where the words name a goal only, chance picks a change, and not always the same one."""
    children = {transform(BASELINES[task], TEXTS[task, name], stream(seed, name), 0.0) for seed in range(12)}
    assert BASELINES[task] not in children
    assert len(children) > 3


@pytest.mark.parametrize("seed", range(12))
def test_faster_is_never_larger_and_slower(seed: int) -> None:
    """The move for speed lowers the parameters or the multiply-adds, and raises neither."""
    child = transform(BASELINES["grating"], TEXTS["grating", "faster"], stream(seed), 0.0)
    before, after = BASELINES["grating"], child
    assert parameters(after) <= parameters(before) or cost(after) < cost(before)
    assert (parameters(after), cost(after)) != (parameters(before), cost(before))


@pytest.mark.parametrize(
    ("words", "edit"),
    [
        ("Increase the number of filters of every convolution by 25%.", _channels(40, 80, 160)),
        ("Double the channels of the second convolution.", _channels(32, 128, 128)),
        ("Make conv3 25 % narrower: fewer channels.", _channels(32, 64, 96)),
        ("Set conv1 to 48 channels.", _channels(48, 64, 128)),
        ("Halve the channels of conv1; leave conv2, conv3 and the head alone.", _channels(16, 64, 128)),
        ("Make the hidden layer twice as large.", _hidden(replace(BASE_HIDDEN, width=1024))),
        ("Give the hidden layer 300 units.", _hidden(replace(BASE_HIDDEN, width=300))),
        ("Add another hidden layer.", _hidden(BASE_HIDDEN, Hidden(width=256))),
        ("Use GELU instead of ReLU.", _activation(Activation.gelu)),
        ("Swap the ReLU non-linearities for SiLU everywhere.", _activation(Activation.silu)),
        ("Use leaky ReLUs.", _activation(Activation.leaky_relu)),
        ("Try ELU in the head.", _hidden(replace(BASE_HIDDEN, activation=Activation.elu))),
        ("Use Swish in conv2.", _block(2, activation=Activation.silu)),
        ("Remove all dropout layers.", _hidden(Hidden(width=512))),
        ("Set the dropout probability to 0.3.", _hidden(Hidden(width=512, dropout=0.3))),
        ("First conv layer: kernel size 5.", _block(1, kernel=5)),
        ("Change the kernel of conv3 to 7x7 (same padding).", _block(3, kernel=7)),
        ("Replace conv3 by a depthwise and a pointwise convolution.", _block(3, separable=True)),
        ("Use average pooling instead of max pooling.", _blocks(down=Down.average)),
        ("Insert group normalisation in conv1.", _block(1, norm=Norm.group)),
        ("Swap batch norm for group norm.", _blocks(norm=Norm.group)),
        ("Add a squeeze-and-excitation gate to each block.", _blocks(attention=Attention.channel)),
        (
            "Attend to positions before the pooling: spatial attention.",
            lambda n: replace(n, attention=Attention.spatial),
        ),
        ("Put a skip connection around the last conv block.", lambda n: replace(n, skips=((2, 3),))),
        ("Concatenate adaptive max pooling with the average.", lambda n: replace(n, pooling=Pooling.both)),
        ("Pool by adaptive average and adaptive max pooling.", lambda n: replace(n, pooling=Pooling.both)),
        ("Use adaptive max pooling in place of adaptive average pooling.", lambda n: replace(n, pooling=Pooling.max)),
        ("Widen conv2.", _channels(32, 80, 128)),
        ("Use fewer channels in conv3.", _channels(32, 64, 96)),
        ("Let the network attend to what matters.", lambda n: replace(n, attention=Attention.spatial)),
        ("Add a residual connection.", lambda n: replace(n, skips=((1, 2),))),
        ("Bound the prediction with a sigmoid.", _output(Output.sigmoid)),
    ],
)
def test_other_wordings_are_understood(words: str, edit: Edit) -> None:
    """A user's rewording reaches the same change."""
    assert transform(BASELINES["force"], words, stream(0), temperature=0.0) == edit(BASELINES["force"])


@pytest.mark.parametrize(
    ("before", "words", "after"),
    [
        (_activation(Activation.leaky_relu), TEXTS["grating", "gelu"], _activation(Activation.gelu)),
        (_blocks(down=Down.average), "Replace the average pooling by max pooling.", _blocks(down=Down.max)),
        (_blocks(norm=Norm.batch), TEXTS["force", "batch_norm"], _blocks(norm=Norm.batch)),
    ],
)
def test_what_stands_there_now_makes_no_difference(before: Edit, words: str, after: Edit) -> None:
    """A layer is exchanged though it is no longer the baseline's, back too, and what is there is not added again."""
    assert follow(before(BASELINES["force"]), words, stream(0)) == after(BASELINES["force"])


def test_block_that_is_gone_stands_for_the_last_one() -> None:
    """The names of the baseline keep a meaning in smaller networks."""
    small = replace(BASELINES["force"], blocks=BASELINES["force"].blocks[:2])
    assert follow(small, TEXTS["force", "separable_conv3"], stream(0)).blocks[1].separable


@pytest.mark.parametrize(
    ("words", "edit"),
    [
        ("Remove the residual connections.", lambda n: replace(n, skips=())),
        ("Get rid of the LayerNorm.", _hidden(BASE_HIDDEN, Hidden(width=64))),
        ("Do without batch normalisation.", _blocks(norm=Norm.none)),
        ("Drop the spatial attention.", lambda n: replace(n, attention=Attention.none)),
        ("Remove the sigmoid.", _output(Output.free)),
        ("Delete the last hidden layer.", _hidden(replace(BASE_HIDDEN, layer_norm=True))),
    ],
)
def test_removals_are_told_from_additions(words: str, edit: Edit) -> None:
    """The words that name a part also serve to take it away."""
    full = replace(BASELINES["force"], skips=((1, 2),), attention=Attention.spatial)
    full = _output(Output.sigmoid)(_blocks(norm=Norm.batch)(full))
    full = _hidden(replace(BASE_HIDDEN, layer_norm=True), Hidden(width=64, layer_norm=True))(full)
    assert follow(full, words, stream(0)) == edit(full)


def test_warmer_requests_change_more() -> None:
    """Temperature 1 leaves fewer children at the instruction alone than 0.3 does; 0 leaves all of them there."""
    asked = CHANGES["gelu"](BASELINES["grating"])

    def alone(temperature: float) -> int:
        text = TEXTS["grating", "gelu"]
        children = [transform(BASELINES["grating"], text, stream(seed), temperature) for seed in range(60)]
        return sum(child == asked for child in children)

    assert alone(0.0) == 60
    assert alone(1.0) < alone(0.3) < 60


def test_network_that_no_variation_changes_comes_back() -> None:
    """A search for a change ends where there is none."""
    assert vary(BASELINES["force"], (lambda network, rng: network,), stream(0)) == BASELINES["force"]


@given(networks(), st.sampled_from(sorted(TEXTS)), st.integers(0, 1000), st.floats(0, 1))
def test_children_stay_within_the_bounds(network: Network, key: tuple[str, str], seed: int, temperature: float) -> None:
    """Whatever the parent, the instruction and the temperature."""
    child = transform(network, TEXTS[key], stream(seed), temperature)
    assert fit(child) == child
    assert child.signature == network.signature
