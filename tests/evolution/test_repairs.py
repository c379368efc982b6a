"""Promise: a repair goes on with the conversation, and what no further turn can mend is not sent back."""

from dataclasses import replace

import pytest

from tacevo.evolution.prompts import repair_request
from tacevo.records import ChatMessage, Reason, Rejection, Request, Stage

ASKED = Request(
    model="m",
    system="s",
    messages=(ChatMessage(role="user", content="Widen it."),),
    temperature=0.7,
    max_tokens=9,
    draw=3,
    settings=(("top_p", 0.9),),
)

FAULT = Rejection(stage=Stage.probe, reason=Reason.bad_output, detail="expected (2, 3); got (2, 4)")


def test_repair_goes_on_with_the_conversation() -> None:
    """The answer and the gate's stage, reason and detail are added; nothing else of the request changes."""
    repair = repair_request(ASKED, "class A: ...", FAULT)
    assert repair is not None
    assert replace(repair, messages=ASKED.messages) == ASKED
    first, answer, reason = repair.messages
    assert first == ASKED.messages[0]
    assert answer == ChatMessage(role="assistant", content="class A: ...")
    assert reason.role == "user"
    assert "'probe' for the reason 'bad_output': expected (2, 3); got (2, 4)" in reason.content
    again = repair_request(repair, "two", FAULT)
    assert again is not None
    assert again.messages[:3] == repair.messages
    assert [turn.role for turn in again.messages] == ["user", "assistant"] * 2 + ["user"]


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        *(("text", reason) for reason in (Reason.empty, Reason.invalid_request, Reason.refused, Reason.too_long)),
        (" \n", Reason.truncated),  # a provider takes no empty turn
    ],
)
def test_what_no_turn_can_mend_is_not_sent_back(answer: str, reason: Reason) -> None:
    """There is nothing to correct, or nothing that could be sent."""
    assert repair_request(ASKED, answer, replace(FAULT, stage=Stage.extract, reason=reason)) is None
