"""Promise: a request reaches Claude whole, and its answer is read whole; a missing key is reported at once."""

from pathlib import Path

import anthropic
import pytest
from asked import KEY, request
from hosted import hosted
from llm_server import serving
from refusals import refused

from tacevo.config.compose import compose
from tacevo.errors import ConfigError
from tacevo.llm.anthropic import connect, connect_batches
from tacevo.records import ChatMessage, Completion, Request
from tacevo.runs.providers import provider_settings


@pytest.fixture(autouse=True)
def _key(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put the key where the SDK looks for it."""
    monkeypatch.setenv("ANTHROPIC_API_KEY", KEY)


def test_request_is_sent_whole() -> None:
    """Model, system prompt, every turn and every setting reach the server; the draw number does not."""
    turns = [("user", "hello"), ("assistant", "hm"), ("user", "hi")]
    asked = Request(
        model="model-x",
        system="Be brief.",
        messages=tuple(ChatMessage(role=role, content=content) for role, content in turns),
        temperature=0.65,
        max_tokens=50_000,  # so many that the SDK would want an answer in pieces
        draw=1,
        settings=(("stop_sequences", ("END",)), ("thinking_tokens", 2048), ("top_k", 40), ("top_p", 0.9)),
    )
    with serving() as server:
        assert len(list(hosted(server.url).complete([asked]))) == 1
        (body,) = server.bodies
    assert body == {
        "model": "model-x",
        "system": "Be brief.",
        "messages": [{"role": role, "content": content} for role, content in turns],
        "temperature": 0.65,
        "max_tokens": 50_000,
        "stream": False,
        "stop_sequences": ["END"],
        "thinking": {"type": "enabled", "budget_tokens": 2048},
        "top_k": 40,
        "top_p": 0.9,
    }
    assert server.logins == {KEY}


def test_settings_of_a_request_are_those_that_are_set() -> None:
    """In the order of their names, beside its own fields."""
    chosen = compose(["llm=anthropic", "llm.top_p=0.9", "llm.stop_sequences=[END]"]).llm
    assert provider_settings(chosen) == (("stop_sequences", ("END",)), ("top_p", 0.9))
    assert provider_settings(compose(["llm=anthropic"]).llm) == ()


def test_answer_is_read_whole() -> None:
    """Text, model as returned, stop reason and tokens are kept."""
    with serving() as server:
        ((position, completion),) = hosted(server.url).complete([request("hi")])
    assert position == 0
    assert completion == Completion(
        text="hi!", model="model-x-dated", stop_reason="end_turn", input_tokens=11, output_tokens=7
    )


def test_missing_key_is_told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before anything is asked or made."""
    monkeypatch.delenv("ANTHROPIC_API_KEY")
    for missing in (lambda: connect(None, 1), lambda: connect_batches(None)):
        with refused(ConfigError, place="ANTHROPIC_API_KEY", remedy="set it, replay"):
            missing()


def test_login_that_is_no_key_is_not_taken(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The SDK finds other logins by itself, whose tokens could not be blacked out."""
    monkeypatch.delenv("ANTHROPIC_API_KEY")
    (tmp_path / "token").write_text("a-token", encoding="utf-8")
    monkeypatch.setenv("ANTHROPIC_IDENTITY_TOKEN_FILE", str(tmp_path / "token"))
    monkeypatch.setenv("ANTHROPIC_FEDERATION_RULE_ID", "fdrl_1")
    monkeypatch.setenv("ANTHROPIC_ORGANIZATION_ID", "org_1")
    with anthropic.Anthropic() as client:
        assert client.credentials is not None
    with refused(ConfigError, place="ANTHROPIC_API_KEY", remedy="set it, replay"):
        connect_batches(None)
