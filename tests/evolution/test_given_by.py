"""Promise: a given network that does not train ends the run, and the error names the setting that gave it."""

from types import SimpleNamespace
from typing import Any

import pytest
from refusals import refused

from tacevo.errors import ConfigError
from tacevo.evolution.algorithm import check_given
from tacevo.records import Given, Operator, Reason, Rejection, Stage


@pytest.mark.parametrize("given_by", ["networks", "search.networks"])
def test_given_network_that_does_not_train_is_named_with_its_setting(given_by: str) -> None:
    """A study has `networks`, a search `search.networks`."""
    rejection = Rejection(stage=Stage.train, reason=Reason.not_finite, detail="nan")
    proposal = SimpleNamespace(request=None, operator=Operator.given, slot=1)
    task = SimpleNamespace(name="force", given=(Given(name="mine", source=""),))
    outcome: Any = SimpleNamespace(proposal=proposal, result=rejection)
    plan: Any = SimpleNamespace(task=task, given_by=given_by)
    with refused(ConfigError, place=f"{given_by}, mine", expected="a network that trains") as caught:
        check_given(outcome, plan)
    assert caught.value.place == f"{given_by}, mine"
