"""The grammar within a closed space: every answer is a member, and the paper's instructions keep their meaning."""

from dataclasses import replace
from typing import cast

import pytest
from refusals import refused

from tacevo.config.compose import compose
from tacevo.config.conf_folder import conf_root
from tacevo.config.identity import llm_identity
from tacevo.config.task_texts import facts_without_data, load_task
from tacevo.errors import ConfigError
from tacevo.evolution.prompts import sample_text
from tacevo.llm.grammar.network import Activation
from tacevo.llm.grammar.parsing import parse
from tacevo.llm.grammar.provider import answer
from tacevo.llm.grammar.rendering import render
from tacevo.llm.grammar.space import genomes, member, mutated, nearest
from tacevo.randomness import stream
from tacevo.records import ChatMessage, Request
from tacevo.runs.providers import provider_settings
from tacevo.space import Space

CONFIG = compose(["experiment=space"])
SPACE = cast(Space, CONFIG.llm.space)
BASELINE = parse((conf_root() / CONFIG.task.baseline).read_text(encoding="utf-8"))
MEMBERS = {render(member(genome, BASELINE.signature)) for genome in genomes(SPACE)}


def _request(text: str, temperature: float = 0.5, draw: int = 0) -> Request:
    message = ChatMessage(role="user", content=text)
    return Request(model="m", system="", messages=(message,), temperature=temperature, max_tokens=4096, draw=draw)


def _asked(*sources: str, instruction: str = "Improve it.") -> str:
    blocks = "\n".join(f"```python\n{source}\n```" for source in sources)
    return f"{blocks}\nInstruction: {instruction}"


def _answered(request: Request) -> str:
    text = answer(request, slip_rate=0.0, space=SPACE).text
    return text.removeprefix("```python\n").removesuffix("```\n")


def test_each_genome_is_a_network_of_its_own_that_reads_back_to_it() -> None:
    """The shipped space has as many networks as it says, and snapping one of them changes nothing."""
    assert len(MEMBERS) == SPACE.size == 768
    assert all(nearest(SPACE, member(genome, BASELINE.signature)) == genome for genome in genomes(SPACE))


def test_the_baseline_is_a_member() -> None:
    """Its genome gives the very network."""
    assert member(nearest(SPACE, BASELINE), BASELINE.signature) == BASELINE


def test_every_answer_is_a_member_and_equal_requests_get_equal_ones() -> None:
    """Mutations, crossovers and samples of any temperature stay within the space, and no kind of them stands still."""
    one, other = sorted(MEMBERS)[::400]
    texts = [_asked(one), _asked(one, other), sample_text(one)]
    answers = {}
    for text in texts:
        for draw in range(12):
            request = _request(text, temperature=draw / 12, draw=draw)
            answers[text, draw] = _answered(request)
            assert answers[text, draw] == _answered(request)
    assert set(answers.values()) <= MEMBERS
    assert all(len({answers[text, draw] for draw in range(12)}) > 1 for text in texts)


def test_a_warmer_answer_has_the_edits_of_a_colder_one() -> None:
    """Without temperature the child is that of the instruction; with it at most four further genes change."""
    for draw in range(8):
        cold, warm = (
            nearest(SPACE, parse(_answered(_request(_asked(render(BASELINE)), temperature, draw))))
            for temperature in (0.0, 1.0)
        )
        assert sum(cold[name] != warm[name] for name in cold) <= 4


def test_each_instruction_changes_a_member() -> None:
    """None of the space's instructions is without meaning there."""
    task = load_task(CONFIG, facts_without_data(CONFIG))
    for instruction in task.instructions:
        changed = [
            genome
            for index, genome in enumerate(list(genomes(SPACE))[::29])
            for parent in [member(genome, BASELINE.signature)]
            if mutated(SPACE, parent, instruction.text, 0.0, stream(0, "test", index)) != parent
        ]
        assert changed, instruction.id


def test_what_a_space_does_not_know_stays_as_the_parent_has_it() -> None:
    """A SiLU is no choice, and is not taken for one of them."""
    gelu = next(genome for genome in genomes(SPACE) if genome["activation"] == "gelu")
    network = member(gelu, BASELINE.signature)
    blocks = tuple(replace(block, activation=Activation.silu) for block in network.blocks)
    assert nearest(SPACE, replace(network, blocks=blocks), gelu) == gelu


def test_a_space_is_part_of_the_request_where_there_is_one() -> None:
    """Runs without one keep their keys; another space is another key."""
    assert dict(provider_settings(compose([]).llm)).keys() == {"slip_rate"}
    narrower = replace(CONFIG.llm, space=replace(SPACE, width=(16,)))
    assert len({provider_settings(llm) for llm in (CONFIG.llm, narrower)}) == 2
    assert "space" not in llm_identity(compose([]).llm)
    assert llm_identity(narrower) != llm_identity(CONFIG.llm)


@pytest.mark.parametrize(
    "override",
    ["llm.space.depth=[1]", "llm.space.width=[16,16]", "llm.space.norm=[layer]", "llm.space.dropout=[]"],
)
def test_a_space_of_other_choices_is_refused(override: str) -> None:
    """The error names the gene."""
    with pytest.raises(ConfigError, match=override.partition("=")[0].removeprefix("llm.space.")):
        compose(["experiment=space", override])


def test_no_other_model_has_a_space() -> None:
    """A language model cannot be held to one."""
    with refused(ConfigError, place="llm.space", expected="null for llm=openai"):
        compose(["experiment=space", "llm.provider=openai", "llm.model=any"])
