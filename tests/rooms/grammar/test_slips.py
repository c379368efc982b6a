"""Each slip puts exactly the fault of its name into an answer; three in ten are harmless."""

import ast
import re
from collections import Counter

import pytest
from grammar_strategies import SIGNATURE, build, networks, train_a_step
from hypothesis import given
from hypothesis import strategies as st

from tacevo.llm.grammar.network import Block, Down, Head, Hidden, Network
from tacevo.llm.grammar.rendering import render
from tacevo.llm.grammar.slips import Slip, draw, proper, spoil
from tacevo.randomness import stream

NETWORK = Network(
    signature=SIGNATURE,
    blocks=tuple(Block(channels=channels, down=Down.max) for channels in (8, 16)),
    head=Head(hidden=(Hidden(width=32),)),
)


def _code(answer: str) -> str:
    """Take the code out of the only fence of an answer."""
    _, code, _ = re.split("```python\n|```", answer)
    return code


def _spoilt(slip: Slip, network: Network = NETWORK) -> str:
    return spoil(network, slip, stream(0))


def test_answers_of_sound_code_differ_in_what_surrounds_it() -> None:
    """A proper one is one fenced block, as the system prompt asks; prose stands around it, and a fence may lack."""
    fenced = f"```python\n{render(NETWORK)}```\n"
    assert proper(NETWORK) == fenced
    before, after = _spoilt(Slip.prose).split(fenced)
    assert before
    assert after
    assert _spoilt(Slip.no_fence) == render(NETWORK)


def test_cut_off_answer_ends_within_the_class() -> None:
    """Its fence stays open."""
    answer = _spoilt(Slip.cut_off)
    assert proper(NETWORK).startswith(answer)
    assert "class ImageRegressionCNN" in answer
    assert "return self.regressor(x)" not in answer


@pytest.mark.parametrize(
    ("slip", "error", "message"),
    [
        (Slip.no_super, AttributeError, "before Module.__init__"),
        (Slip.missing_import, NameError, "einops"),
        (Slip.wrong_channels, RuntimeError, "expected input.* to have 16 channels"),
        (Slip.undefined_name, AttributeError, "feature_norm"),
    ],
)
def test_faults_show_when_the_class_is_used(slip: Slip, error: type[Exception], message: str) -> None:
    """The first two when it is built, the others in the forward pass."""
    with pytest.raises(error, match=message):
        train_a_step(build(_code(_spoilt(slip)), SIGNATURE.class_name), 3, image_size=32)


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
