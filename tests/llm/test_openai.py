"""Promise: a request reaches a chat-completions server whole and its answer is read whole; what is missing is told."""

import subprocess
import sys
from typing import Any

import pytest
from hosted import KEY, hosted, request
from llm_server import serving
from openai.types.chat import ChatCompletion
from refusals import refused

from tacevo.errors import ConfigError
from tacevo.llm.openai import body_of, completion_of, connect
from tacevo.llm.retry import FaultError, FaultKind
from tacevo.records import Completion


@pytest.fixture(autouse=True)
def _no_key(monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin without a key."""
    for name in ("OPENAI_API_KEY", "OPENAI_BASE_URL"):
        monkeypatch.delenv(name, raising=False)


def test_request_is_sent_whole() -> None:
    """The system prompt is the first turn, the draw number is the seed, and settings have this API's names."""
    asked = request("hi", draw=42, settings=(("stop_sequences", ("END",)), ("top_k", 40), ("top_p", 0.9)))
    with serving() as server:
        list(hosted(server.url, "openai").complete([asked]))
        (body,) = server.bodies
    assert body == {
        "model": "model-x",
        "messages": [{"role": "system", "content": "Be brief."}, {"role": "user", "content": "hi"}],
        "temperature": 0.65,
        "seed": 42,
        "max_tokens": 77,
        "stop": ["END"],
        "top_k": 40,
        "top_p": 0.9,
    }


def test_token_limit_has_the_name_that_the_server_knows() -> None:
    """OpenAI's own newer models know one name only, and other servers perhaps only the other."""
    assert body_of(request("a"), (), limit_name="max_completion_tokens")["max_completion_tokens"] == 77


def test_server_of_ones_own_wants_no_key(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a key in the environment something stands in for it; with one, it is sent."""
    with serving() as server:
        list(hosted(server.url, "openai").complete([request("a")]))
        monkeypatch.setenv("OPENAI_API_KEY", KEY)
        list(hosted(server.url, "openai").complete([request("b")]))
        assert server.logins == {"no-key", KEY}


def test_missing_key_for_the_makers_server_is_told_at_once() -> None:
    """Before anything is asked or made."""
    with refused(ConfigError, place="OPENAI_API_KEY", remedy="llm.base_url"):
        connect(None, 1)


def test_missing_extra_is_told_with_its_remedy() -> None:
    """Where the SDK is not installed, the message holds the command that installs it."""
    script = "import sys; sys.modules['openai'] = None; import tacevo.llm.openai"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "expected the openai SDK; got nothing; install it with: pip install 'tacevo[openai]'" in done.stderr


def chat(**choice: object) -> ChatCompletion:
    """Make an answer as the SDK hands it on: unchecked."""
    message = {"role": "assistant", "content": choice.pop("content", "hi"), **choice}
    finish = message.pop("finish_reason", "stop")
    choices = [{"index": 0, "message": message, "finish_reason": finish}]
    return ChatCompletion.construct(None, id="1", model="m-1", choices=choices, usage=None)


def test_answer_without_counts_counts_as_free() -> None:
    """Some servers count no tokens."""
    assert completion_of(chat()) == Completion(
        text="hi", model="m-1", stop_reason="end_turn", input_tokens=0, output_tokens=0
    )


@pytest.mark.parametrize(
    ("finish", "stop_reason"),
    [
        ("stop", "end_turn"),
        ("length", "max_tokens"),
        ("content_filter", "refusal"),
        ("tool_calls", "tool_calls"),
        (None, "end_turn"),
    ],
)
def test_stop_reasons_are_those_of_the_gate(finish: str | None, stop_reason: str) -> None:
    """What the Messages API has a name for gets that name; the rest is kept."""
    assert completion_of(chat(finish_reason=finish)).stop_reason == stop_reason


def test_refusal_in_the_message_is_a_refusal() -> None:
    """Newer models refuse in a field of its own, without content."""
    completion = completion_of(chat(content=None, refusal="I cannot"))
    assert (completion.text, completion.stop_reason) == ("", "refusal")


@pytest.mark.parametrize("choices", [[], None, 5, {"0": "text"}, ["text"], [None], [{}], [{"message": None}]])
def test_answer_without_choices_is_none(choices: Any) -> None:
    """It is asked for again, not recorded; the SDK lets any values through."""
    with pytest.raises(FaultError) as caught:
        completion_of(ChatCompletion.construct(None, id="1", model="m", choices=choices, usage=None))
    assert caught.value.fault.kind is FaultKind.passing
