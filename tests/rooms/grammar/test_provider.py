"""The provider answers every request, the same way each time, over many generations."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import pytest
from checkout import LIBRARY

from tacevo.choices import Effort
from tacevo.evolution.carriers import boldness_text
from tacevo.evolution.development import LLM
from tacevo.evolution.prompts import SAMPLING, crossover_text, mutation_text, sample_text
from tacevo.llm.grammar import provider
from tacevo.llm.grammar.bounds import fit
from tacevo.llm.grammar.network import Network
from tacevo.llm.grammar.parsing import parse
from tacevo.llm.grammar.provider import MODEL, GrammarLLM
from tacevo.records import ChatMessage, Completion, Request
from tacevo.storage.canonical import content_hash

BASELINE = (LIBRARY / "force" / "baseline.py").read_text()


def _request(content: str, *, temperature: float = 0.6, draw: int = 0) -> Request:
    return Request(
        model=MODEL,
        system="You write networks.",
        messages=(ChatMessage(role="user", content=content),),
        temperature=temperature,
        max_tokens=4096,
        draw=draw,
    )


def _mutation(parent: str, instruction: str) -> str:
    return f"Parent network:\n\n```python\n{parent}\n```\n\nInstruction: {instruction}\n"


def _crossover(first: str, second: str, instruction: str) -> str:
    return (
        f"First parent network:\n\n```python\n{first}\n```\n\n"
        f"Second parent network:\n\n```python\n{second}\n```\n\nInstruction: {instruction}\n"
    )


def _answers(requests: Sequence[Request], slip_rate: float = 0.0) -> list[Completion]:
    llm: LLM = GrammarLLM(slip_rate=slip_rate)
    answers = dict(llm.complete(requests))
    return [answers[position] for position in range(len(requests))]


def _source(answer: Completion) -> str:
    assert answer.text.startswith("```python\n")
    return answer.text.removeprefix("```python\n").removesuffix("```\n")


#: The baseline with the docstring that it had when this model's answers were pinned: it is part of a request.
PINNED = '"""The paper\'s baseline for the force task: three convolutional blocks and one hidden layer."""\n'
PINNED += BASELINE.partition("\n")[2]

#: A second parent: the baseline's relative with wider kernels and another pooling.
RELATIVE = PINNED.replace("kernel_size=3, padding=1", "kernel_size=5, padding=2").replace("Max", "Avg")
GELU = _mutation(BASELINE, "Exchange each ReLU for a GELU.")


def test_equal_requests_get_equal_answers() -> None:
    """In any company and order, from any instance."""
    others = [_request(GELU, draw=draw) for draw in range(1, 4)]
    assert _answers([_request(GELU), *others])[0] == _answers([*others, _request(GELU)])[-1]


def test_answers_are_those_of_this_model_name() -> None:
    """Stored completions stay true: whoever changes these answers on purpose gives MODEL another name."""
    requests = [
        _request(_mutation(PINNED, instruction), temperature=1.0, draw=draw)
        for instruction in ("Refine it.", "Make it faster.", "Use GELU.")
        for draw in range(20)
    ]
    requests += [_request(_crossover(PINNED, RELATIVE, "Combine both."), draw=draw) for draw in range(20)]
    texts = [answer.text for answer in _answers(requests, slip_rate=0.3)]
    assert (MODEL, content_hash(texts)) == (
        "grammar-2",
        "accd5a476ce1935118ccc0e873a78cfe63c199bc0ad8d1d0b2ccc4fe38316b20",
    )


def test_draw_number_changes_the_answer() -> None:
    """Equal prompts give distinct answers in distinct draws, unless the temperature is 0."""
    texts = {answer.text for answer in _answers([_request(GELU, draw=draw) for draw in range(8)])}
    assert len(texts) > 4
    cold = [_request(GELU, temperature=0.0, draw=draw) for draw in range(5)]
    assert len({answer.text for answer in _answers(cold)}) == 1


@pytest.mark.parametrize("content", [GELU, _crossover(PINNED, RELATIVE, "Combine both.")])
def test_warmer_request_gets_the_same_network_with_further_edits(content: str) -> None:
    """So a little warmth mostly changes nothing, and a draw has at most one network for each number of edits."""
    changed = 0
    for draw in range(20):
        warmth = [_request(content, temperature=step / 40, draw=draw) for step in range(41)]
        texts = [answer.text for answer in _answers(warmth)]
        steps = [after != before for before, after in pairwise(texts)]
        assert sum(steps) <= 4
        changed += sum(steps)
    assert changed > 20  # each of four edits comes by T = 1 with a chance of a half


@pytest.mark.parametrize(
    "write", [mutation_text, lambda parent, text, **more: crossover_text(parent, RELATIVE, text, **more)]
)
def test_whatever_carries_a_temperature_is_that_temperature(write: Callable[..., str]) -> None:
    """A sentence or an effort stands for the middle of its part of [0, 1], nothing for 0.5; no draw differs."""
    plain, text = write(PINNED, "Use GELU."), "Change, and keep, one thing."
    for draw in range(8):
        worded = [write(PINNED, "Use GELU.", boldness=boldness_text(level, text)) for level in range(1, 6)]
        efforts = [(("effort", effort.value),) for effort in Effort]
        carried = [replace(_request(content, draw=draw), temperature=None) for content in worded]
        carried += [replace(_request(plain, draw=draw), temperature=None, settings=effort) for effort in efforts]
        carried += [replace(_request(plain, draw=draw), temperature=None)]
        sent = [_request(plain, temperature=temperature, draw=draw) for temperature in (0.1, 0.3, 0.5, 0.7, 0.9)]
        expected = [answer.text for answer in _answers(sent)]
        assert [answer.text for answer in _answers(carried)] == [*expected, *expected, expected[2]]


def test_completion_names_the_grammar_and_counts_tokens() -> None:
    """A quarter of the characters, rounded up, whatever model was asked for."""
    (answer,) = _answers([replace(_request(GELU), model="another")])
    assert (answer.model, answer.stop_reason) == ("grammar-2", "end_turn")
    assert answer.output_tokens == -(-len(answer.text) // 4)
    assert answer.input_tokens == -(-(len(GELU) + len("You write networks.")) // 4)


def test_answer_longer_than_allowed_is_cut() -> None:
    """As a hosted model would, with the stop reason that says so; a slip that cuts an answer off says it, too."""
    (answer,) = _answers([replace(_request(GELU), max_tokens=50)])
    assert (len(answer.text), answer.output_tokens, answer.stop_reason) == (200, 50, "max_tokens")
    slips = _answers([_request(GELU, draw=draw) for draw in range(40)], slip_rate=1.0)
    assert {slip.stop_reason for slip in slips if slip.text.count("```") == 1} == {"max_tokens"}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (_mutation(BASELINE.replace("nn.Flatten()", "nn.Unfold(2)"), "Use GELU."), "nn.Unfold"),
        (_mutation("class Broken(", "Use GELU."), "not valid Python"),
        (_mutation("", "Use GELU."), "none"),
        ("", "found 0 parents"),
        (f"```python\n{BASELINE}\n```", "instruction"),
    ],
)
def test_unreadable_request_gets_words_and_no_code(content: str, said: str) -> None:
    """The gate rejects such an answer; the provider never raises over it."""
    (answer,) = _answers([_request(content)], slip_rate=1.0)
    assert said in answer.text
    assert "```" not in answer.text
    assert "nn.Module" not in answer.text
    assert answer.stop_reason == "end_turn"


def test_samples_are_different_networks_whatever_the_temperature() -> None:
    """Every draw walks from the baseline by itself; most end at another network, some near and some far from it."""
    requests = [_request(sample_text(BASELINE), temperature=0.0, draw=draw) for draw in range(40)]
    networks = [parse(_source(answer)) for answer in _answers(requests)]
    start = parse(BASELINE)
    assert len({str(network) for network in networks}) > 35
    assert start not in networks
    assert {network.signature for network in networks} == {start.signature}
    assert len({len(network.blocks) for network in networks}) > 3
    for network in networks:
        assert fit(network) == network


def test_only_the_whole_message_asks_for_a_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same words as an instruction of somebody's library ask for a mutation, as every instruction does."""
    drawn: list[Network] = []

    def wandered(network: Network, rng: object) -> Network:
        drawn.append(network)
        return network

    monkeypatch.setattr(provider, "wander", wandered)
    _answers([_request(_mutation(BASELINE, SAMPLING)), _request(_crossover(BASELINE, RELATIVE, SAMPLING))])
    assert not drawn
    _answers([_request(sample_text(BASELINE))])
    assert drawn == [parse(BASELINE)]


def test_slips_spoil_answers_but_not_the_networks_of_others() -> None:
    """The network does not depend on the slip rate: answers that are spared stay the same."""
    requests = [_request(GELU, draw=draw) for draw in range(60)]
    clean, some = _answers(requests), _answers(requests, slip_rate=0.3)
    spared = sum(one == other for one, other in zip(clean, some, strict=True))
    assert 30 <= spared < 60
    assert all(one != other for one, other in zip(clean, _answers(requests, slip_rate=1.0), strict=True))
