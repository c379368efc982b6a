"""Promise: what a model is told, how it answers and which models are asked is checked before the first request."""

from typing import Any

import pytest
from refusals import refused

from tacevo.choices import Tell
from tacevo.config.compose import compose
from tacevo.config.identity import identity
from tacevo.config.plain import from_plain
from tacevo.errors import ConfigError
from tacevo.records import to_json

SEVERAL = "llm.models={a: 1, b: 3}"


@pytest.mark.parametrize(
    ("overrides", "place"),
    [
        (["prompts.tells=[labels]"], "prompts.tells"),
        (["prompts.tells=best"], "prompts.tells"),
        (["prompts.tells=[fitness,shuffled]"], "prompts.tells"),
        (["prompts.answer=diff"], "prompts.answer"),
        (["llm=anthropic", "llm.models=[a]"], "llm.models"),
        (["llm=anthropic", "llm.models=[a,a]"], "llm.models"),
        (["llm=anthropic", "llm.models={a: 0, b: 1}"], "llm.models"),
        (["llm=anthropic", "llm.models=[a,/home/me/model]"], "llm.models"),
        (["llm=anthropic", "llm.models=3"], "llm.models"),
        (["llm=anthropic", "llm.choice=bandit"], "llm.choice"),
        (["llm=anthropic", SEVERAL, "llm.choice=bandit"], "llm.models"),
        (["llm=anthropic", SEVERAL, "llm.label=c"], "llm.label"),
        (["llm=openai"], "llm.model"),
        (["ablation=random_sampling", "prompts.tells=[best]"], "prompts.tells"),
        (["ablation=random_sampling", "prompts.answer=edit"], "prompts.answer"),
    ],
)
def test_choice_that_cannot_act_is_refused(overrides: list[str], place: str) -> None:
    """By the key of the setting."""
    with refused(ConfigError, place=place):
        compose(overrides)


def test_models_are_a_list_or_a_mapping() -> None:
    """In the user's order, which run.json keeps; without weights they weigh alike. `llm.model` may be empty."""
    weighed = compose(["llm=openai", "llm.models={b: 3, a: 1}"])
    assert weighed.llm.models == (("b", 3.0), ("a", 1.0))
    assert compose(["llm=openai", "llm.models=[b,a]"]).llm.models == (("b", 1.0), ("a", 1.0))
    assert from_plain(to_json(weighed)) == weighed
    assert weighed.llm.name == "b, a"


def test_order_of_tells_does_not_matter() -> None:
    """One that is named twice is told once."""
    config = compose(["prompts.tells=[notes,fitness,notes]"])
    assert config.prompts.tells == (Tell.fitness, Tell.notes)


def test_each_choice_is_another_run_and_none_is_the_run_of_before() -> None:
    """The ledger's first line and run.json hold a choice where it is made, and have no place for it elsewhere."""
    plain = compose(["llm=anthropic"])
    choices = [
        *([f"prompts.tells=[{tell}]"] for tell in Tell),
        ["prompts.answer=edit"],
        ["llm.models=[a,b]"],
        ["llm.models=[b,a]"],
        [SEVERAL],
        ["llm.models=[a,b]", "llm.choice=bandit"],
    ]
    identities = [identity(plain), *(identity(compose(["llm=anthropic", *choice])) for choice in choices)]
    assert all(one not in identities[:number] for number, one in enumerate(identities))
    held: Any = to_json(plain)
    assert not {"tells", "answer"} & held["prompts"].keys()
    assert not {"models", "choice"} & held["llm"].keys()
    several = identity(compose(["llm=anthropic", SEVERAL, "llm.model=c"]))
    assert several == identity(compose(["llm=anthropic", SEVERAL]))  # where there are several, llm.model says nothing
