"""Promise: what a server refuses is told in its own words, with the setting that mends it; no answer is lost."""

from pathlib import Path
from typing import Any

import pytest
from asked import request
from hosted import PROVIDERS, QUICK, hosted, texts
from raw_server import Reply, replying
from refusals import refused
from test_answers import chat

from tacevo.errors import ConfigError, TransportError
from tacevo.llm.failures import Models
from tacevo.llm.hosted import HostedLLM
from tacevo.llm.openai import Dialect, connect
from tacevo.llm.recording import RecordingLLM
from tacevo.records import Json, to_json
from tacevo.storage.store import Store

pytestmark = pytest.mark.usefixtures("keys")
both = pytest.mark.parametrize("provider", PROVIDERS)

UNSUPPORTED = {
    "message": "Unsupported parameter: 'max_tokens' is not supported with this model. Use 'max_completion_tokens'.",
    "type": "invalid_request_error",
    "param": "max_tokens",
    "code": "unsupported_parameter",
}

#: How servers refuse a name of the token limit.
UNKNOWN_NAMES: list[tuple[int, Json]] = [
    (400, {"error": UNSUPPORTED}),
    (400, {"object": "error", "message": "max_tokens: unknown field", "code": 400}),
    (
        422,
        {
            "detail": [
                {"type": "extra_forbidden", "loc": ["body", "max_tokens"], "msg": "Extra inputs are not permitted"}
            ]
        },
    ),
]


@pytest.mark.parametrize(("status", "refusal"), UNKNOWN_NAMES)
def test_other_name_of_the_limit_is_tried_and_remembered(status: int, refusal: Json, tmp_path: Path) -> None:
    """A run learns it once, also for its later rounds; nothing of it is recorded."""

    def reply(body: dict[str, Any], number: int) -> Reply:
        return (status, refusal) if "max_tokens" in body else (200, chat())

    dialect, store = Dialect(), Store(tmp_path, "completions")
    with replying(reply) as server:
        llm = HostedLLM(
            lambda: connect(f"{server.url}/v1", 1, dialect), concurrency=1, models=Models("llm=openai"), patience=QUICK
        )
        recording = RecordingLLM(llm, store)
        for text in "abc":
            assert [answer.dropped for _, answer in recording.complete([request(text)])] == [()]
        names = [sorted(name for name in body if name.startswith("max_")) for body in server.bodies]
    assert names == [["max_tokens"], *([["max_completion_tokens"]] * 3)]
    assert all(store.read(to_json(request(text))) is not None for text in "abc")


def test_limit_that_is_unknown_by_both_names_is_told() -> None:
    """Each is tried once, and the server's words are shown."""
    with replying((400, {"error": {"message": "max_tokens and max_completion_tokens are unknown here"}})) as server:
        with refused(ConfigError, got="are unknown here"):
            texts(hosted(server.url, "openai", patience=QUICK), "a")
        assert len(server.bodies) == 2


@both
@pytest.mark.parametrize(
    "body",
    [
        {"error": {"message": "max_tokens is too large: 100000. This model supports at most 16384"}},
        {"detail": [{"loc": ["body", "max_tokens"], "msg": "Input should be less than or equal to 4096"}]},
    ],
)
def test_limit_that_is_too_large_is_named(body: Json, provider: str) -> None:
    """The server's words are shown with the setting to lower, also where another name was tried."""

    def reply(asked: dict[str, Any], number: int) -> Reply:
        return (422, body) if "max_tokens" in asked else (422, {"detail": "max_completion_tokens: no such field"})

    with replying(reply) as server, refused(ConfigError, got="max_tokens", remedy="llm.max_tokens") as caught:
        texts(hosted(server.url, provider, patience=QUICK), "a")
    assert "no such field" not in caught.value.got


@both
@pytest.mark.parametrize(
    ("status", "words"),
    [
        (400, "Conversation roles must alternate user/assistant/user/assistant/..."),
        (422, "Only user and assistant roles are supported!"),
        (400, "Developer instruction is not enabled for models/gemma-3"),
        (422, "this model does not support system prompts"),
    ],
)
def test_model_without_a_system_prompt_is_told_the_setting(words: str, status: int, provider: str) -> None:
    """It is asked once, and not ten times."""
    with replying((status, {"object": "error", "message": words, "param": None, "code": status})) as server:
        with refused(ConfigError, got=words, remedy="set llm.system=user"):
            texts(hosted(server.url, provider, patience=QUICK), "a")
        assert len(server.bodies) == 1


@both
@pytest.mark.parametrize(
    ("body", "words"),
    [
        ({"detail": [{"loc": ["body", "n"], "msg": "no such thing", "input": {"seed": 3}}]}, "body n no such thing"),
        ({"detail": {"message": "no such thing"}}, "no such thing"),
        ({"error": "no such thing"}, "no such thing"),
        ({"errors": [{"message": "no such\nthing"}]}, "no such thing"),
        ({"error": {"error": {"error": {"msg": "no such thing"}}}}, "no such thing"),
    ],
)
def test_words_are_found_wherever_a_server_puts_them(body: Json, words: str, provider: str) -> None:
    """FastAPI's list, a text, an object in an object; what it repeats of the request is left out."""
    with replying((422, body)) as server:
        with refused(ConfigError, got=words, remedy="check llm.base_url") as caught:
            texts(hosted(server.url, provider, patience=QUICK), "a")
        assert len(server.bodies) == 1
    assert "{" not in caught.value.got


def test_setting_that_fastapi_forbids_is_dropped() -> None:
    """The name in its list is enough; the request is then answered."""

    def reply(body: dict[str, Any], number: int) -> Reply:
        detail = [{"type": "extra_forbidden", "loc": ["body", "seed"], "msg": "Extra inputs are not permitted"}]
        return (422, {"detail": detail}) if "seed" in body else (200, chat())

    with replying(reply) as server:
        ((_, completion),) = hosted(server.url, "openai", patience=QUICK).complete([request("a")])
    assert completion.dropped == ("seed",)


@pytest.mark.parametrize(
    ("provider", "body"),
    [
        ("anthropic", {"error": {"message": "it is busy", "code": "503"}}),
        ("openai", {"error": "it is busy"}),
        # a router has it beside the message that it could not get
        ("openai", {"choices": [{"error": {"message": "it is busy"}, "message": {}, "finish_reason": None}]}),
    ],
)
def test_error_in_a_body_of_status_200_is_the_servers(provider: str, body: Json) -> None:
    """Its own words are shown, after all tries."""
    with replying((200, body)) as server:
        with refused(TransportError, got="it is busy"):
            texts(hosted(server.url, provider, patience=QUICK), "a")
        assert len(server.bodies) == QUICK.tries
