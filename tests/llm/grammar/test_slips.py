"""Each slip puts exactly the fault of its name into an answer; three in ten are harmless."""

import ast
from collections import Counter

import pytest
from grammar_strategies import SIGNATURE, build, networks, train_a_step
from hypothesis import given
from hypothesis import strategies as st

from tacevo.llm.grammar.network import Block, Down, Head, Hidden, Network
from tacevo.llm.grammar.rendering import render
from tacevo.llm.grammar.slips import Answer, Slip, draw, proper, spoil
from tacevo.randomness import stream

NETWORK = Network(
    signature=SIGNATURE,
    blocks=tuple(Block(channels=channels, down=Down.max) for channels in (8, 16)),
    head=Head(hidden=(Hidden(width=32),)),
)


def _code(answer: Answer) -> str:
    """Take the code out of the only fence of an answer."""
    before, opening, rest = answer.text.partition("```python\n")
    code, closing, _ = rest.partition("```")
    assert opening, before
    assert closing
    return code


def _spoilt(slip: Slip, network: Network = NETWORK) -> Answer:
    return spoil(network, slip, stream(0))


def test_proper_answer_is_one_fenced_block_and_nothing_else() -> None:
    """What the format rules of the system prompt ask for."""
    assert proper(NETWORK) == Answer(text=f"```python\n{render(NETWORK)}```\n", stop_reason="end_turn")


def test_prose_surrounds_sound_code() -> None:
    """A good extraction finds the class between the sentences."""
    answer = _spoilt(Slip.prose)
    assert _code(answer) == render(NETWORK)
    assert not answer.text.startswith("```")
    assert not answer.text.endswith("```\n")


def test_missing_fence_leaves_sound_code() -> None:
    """The answer is the bare source."""
    assert _spoilt(Slip.no_fence) == Answer(text=render(NETWORK))


def test_cut_off_answer_ends_within_the_class() -> None:
    """It says so in its stop reason, and its fence stays open."""
    answer = _spoilt(Slip.cut_off)
    assert answer.stop_reason == "max_tokens"
    assert answer.text.count("```") == 1
    assert "class ImageRegressionCNN" in answer.text
    assert "return self.regressor(x)" not in answer.text


@pytest.mark.parametrize(
    ("slip", "error", "message"),
    [
        (Slip.no_super, AttributeError, "before Module.__init__"),
        (Slip.missing_import, NameError, "einops"),
    ],
)
def test_faults_that_show_in_the_constructor(slip: Slip, error: type[Exception], message: str) -> None:
    """The class cannot be built."""
    with pytest.raises(error, match=message):
        build(_code(_spoilt(slip)), SIGNATURE.class_name)


@pytest.mark.parametrize(
    ("slip", "error", "message"),
    [
        (Slip.wrong_channels, RuntimeError, "expected input.* to have 16 channels"),
        (Slip.undefined_name, AttributeError, "feature_norm"),
    ],
)
def test_faults_that_show_in_the_forward_pass(slip: Slip, error: type[Exception], message: str) -> None:
    """The class can be built but not used."""
    module = build(_code(_spoilt(slip)), SIGNATURE.class_name)
    with pytest.raises(error, match=message):
        train_a_step(module, 3, image_size=32)


def test_wrong_outputs_show_in_the_shape_only() -> None:
    """The network runs and gives one value too many."""
    module = build(_code(_spoilt(Slip.wrong_outputs)), SIGNATURE.class_name)
    assert train_a_step(module, 3, image_size=32).shape == (2, 4)


@given(networks(), st.sampled_from(sorted(set(Slip) - {Slip.prose, Slip.no_fence, Slip.cut_off})))
def test_every_network_can_carry_every_slip(network: Network, slip: Slip) -> None:
    """The fault changes the source, which stays valid Python."""
    spoilt = _code(_spoilt(slip, network))
    assert spoilt != render(network)
    ast.parse(spoilt)


def test_foreign_import_brings_what_the_format_rules_forbid() -> None:
    """The rest of the answer is sound, so only a look at the imports can tell."""
    code = _code(_spoilt(Slip.foreign_import))
    assert code.endswith(render(NETWORK))
    assert code.startswith("from torchvision import")


def test_three_slips_in_ten_are_harmless() -> None:
    """Prose and the missing fence; every other kind is as frequent as the next."""
    slips = Counter(draw(1.0, stream(0, number)) for number in range(2000))
    assert set(slips) == set(Slip)
    assert 520 < slips[Slip.prose] + slips[Slip.no_fence] < 680
    assert all(140 < slips[slip] < 260 for slip in set(Slip) - {Slip.prose})


def test_slip_rate_is_the_share_of_faulty_answers() -> None:
    """None at 0, all at 1."""
    assert not any(draw(0.0, stream(0, number)) for number in range(200))
    assert 60 < sum(draw(0.1, stream(0, number)) is not None for number in range(1000)) < 140
