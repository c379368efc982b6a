"""Promise: an answer that comes in pieces is joined and paid for once; one that is not finished is no answer.

The real SDKs read the bodies from a real server, which sends a stream although none was asked for.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from asked import request
from hosted import QUICK, hosted
from hypothesis import given
from hypothesis import strategies as st
from raw_server import replying
from refusals import refused
from test_answers import USAGE, chat, message

from tacevo.errors import ConfigError, TransportError
from tacevo.llm.bodies import read_body, read_chat, read_message
from tacevo.llm.recording import RecordingLLM
from tacevo.llm.retry import FaultError
from tacevo.llm.wire import MOST_BYTES
from tacevo.records import Completion, Delivery, Json
from tacevo.storage.store import Store

pytestmark = pytest.mark.usefixtures("keys")

EVENTS = {"content-type": "text/event-stream; charset=utf-8"}


def chunk(text: str | None = None, reason: str | None = None, **fields: Any) -> dict[str, Any]:
    """Write a piece of a chat-completions stream."""
    delta = {} if text is None else {"content": text}
    choice = {"index": 0, "delta": delta, "finish_reason": reason}
    return {"object": "chat.completion.chunk", "model": "m1", "choices": [choice], **fields}


def events(*values: Json, done: bool = True, line: str = "\n") -> bytes:
    """Write an event stream."""
    texts = [json.dumps(value) for value in values] + ["[DONE]"] * done
    return "".join(f"data: {text}{line}{line}" for text in texts).encode()


def named(*values: dict[str, Any]) -> bytes:
    """Write an event stream whose events have names, as the Messages API does."""
    return "".join(f"event: {value['type']}\ndata: {json.dumps(value)}\n\n" for value in values).encode()


HALVES = (chunk("", role="assistant"), chunk("h"), chunk("i"))
END: tuple[Json, ...] = (chunk(None, "stop"), {"choices": [], "usage": USAGE})

PIECES: tuple[dict[str, Any], ...] = (
    {
        "type": "message_start",
        "message": {**message(), "content": [], "stop_reason": None, "usage": {"input_tokens": 10}},
    },
    {"type": "content_block_start", "index": 0, "content_block": {"type": "thinking", "thinking": ""}},
    {"type": "content_block_delta", "index": 0, "delta": {"type": "thinking_delta", "thinking": "no"}},
    {"type": "content_block_stop", "index": 0},
    {"type": "content_block_start", "index": 1, "content_block": {"type": "text", "text": ""}},
    {"type": "ping"},
    {"type": "content_block_delta", "index": 1, "delta": {"type": "text_delta", "text": "h"}},
    {"type": "content_block_delta", "index": 1, "delta": {"type": "text_delta", "text": "i"}},
    {"type": "content_block_stop", "index": 1},
    {"type": "message_delta", "delta": {"stop_reason": "end_turn"}, "usage": {"output_tokens": 20}},
    {"type": "message_stop"},
)

WHOLE = json.dumps(chat()).encode()

#: Bodies whose text is `hi`, of 10 and 20 tokens, by what is odd about them; the provider in front.


def _swapped(body: dict[str, Any]) -> dict[str, Any]:
    """Put a second choice before the first, which alone was asked for."""
    (first,) = body["choices"]
    return {
        **body,
        "choices": [{"index": 1, "message": {"content": "no"}, "finish_reason": "stop"}, {**first, "index": 0}],
    }


SOUND: dict[str, tuple[str, bytes]] = {
    "done behind the answer": ("openai", WHOLE + b"\n\ndata: [DONE]\n\n"),
    "done without a mark": ("openai", WHOLE + b"[DONE]"),
    "one event": ("openai", events(chat())),
    "one event that is not ended": ("openai", b"data:" + WHOLE),
    "comments before it": ("openai", b": OPENROUTER PROCESSING\n\n: OPENROUTER PROCESSING\n\n" + WHOLE),
    "something behind it": ("openai", WHOLE + b"\n<!-- served by a proxy -->"),
    "an answer in a list": ("openai", b"[" + WHOLE + b"]"),
    "the same twice": ("openai", WHOLE + b"\n" + WHOLE),
    "pieces": ("openai", events(*HALVES, *END)),
    "pieces that say that they go on": ("openai", events(chunk("h", "null"), chunk("i", "in_progress"), *END)),
    "choices in another order": ("openai", json.dumps(_swapped(chat())).encode()),
    "pieces without the last word": ("openai", events(*HALVES, *END, done=False)),
    "pieces without a reason": ("openai", events(*HALVES, {"choices": [], "usage": USAGE})),
    "pieces with other line ends": ("openai", events(*HALVES, *END, line="\r\n")),
    "pieces a line each": ("openai", b"\n".join(json.dumps(value).encode() for value in (*HALVES, *END))),
    "pieces as a list": ("openai", json.dumps([*HALVES, *END]).encode()),
    "pieces over several lines": (
        "openai",
        b"".join(
            "".join(f"data: {line}\n" for line in json.dumps(value, indent=1).split("\n")).encode() + b"\n"
            for value in (*HALVES, *END)
        ),
    ),
    "pieces, cut off behind the end": (
        "openai",
        events(*HALVES, chunk(None, "stop", usage=USAGE), {"choices": [], "usage": USAGE}, done=False)[:-25],
    ),
    "pieces and the whole": ("openai", events(*HALVES, chat())),
    "wholes that grow": ("openai", events(*(chat(content=text, finish_reason=None) for text in "h"), chat())),
    "usage with each piece": (
        "openai",
        events(chunk("h", usage={**USAGE, "completion_tokens": 1}), chunk("i", "stop", usage=USAGE)),
    ),
    "pieces of parts": ("openai", events(chunk([{"type": "text", "text": "hi"}]), *END)),  # type: ignore[arg-type]
    "messages": ("anthropic", named(*PIECES)),
    "messages without the last word": ("anthropic", named(*PIECES[:-1])),
    "a message as an event": ("anthropic", named(message())),
    "done behind a message": ("anthropic", json.dumps(message()).encode() + b"\n\ndata: [DONE]\n\n"),
}


@pytest.mark.parametrize("name", SOUND)
@pytest.mark.parametrize("media", ["text/event-stream", "application/json"])
def test_finished_answer_is_joined_and_paid_for_once(name: str, media: str, tmp_path: Path) -> None:
    """Whatever it is sent as, its text, reason and tokens are those of the answer."""
    provider, data = SOUND[name]
    store = Store(tmp_path, "completions")
    with replying((200, data), {"content-type": media}) as server:
        ((_, answer),) = RecordingLLM(hosted(server.url, provider, patience=QUICK), store).complete([request("a")])
        assert [body["stream"] for body in server.bodies] == [False]
    assert (answer.text, answer.stop_reason, answer.tokens, answer.model) == ("hi", "end_turn", (10, 20), "m1")


UNFINISHED: dict[str, tuple[str, bytes]] = {
    "pieces": ("openai", events(*HALVES, done=False)),
    "a piece cut in two": ("openai", events(*HALVES, done=False)[:-25]),
    "no piece": ("openai", b"data:"),
    "done alone": ("openai", b"data: [DONE]\n\n"),
    "no text and no reason": ("openai", events(chunk(""))),
    "messages": ("anthropic", named(*PIECES[:-2])),
    "a piece alone": ("openai", json.dumps(chunk("hi")).encode()),
    "failed": ("openai", events(*HALVES, chunk("", "error"))),
    "an answer without its end": ("openai", WHOLE[:-20] + b"\n\ndata: [DONE]\n\n"),
}


@pytest.mark.parametrize("name", UNFINISHED)
def test_answer_that_is_not_finished_is_asked_for_again(name: str, tmp_path: Path) -> None:
    """As often as any other failure, and half an answer is never recorded."""
    provider, data = UNFINISHED[name]
    store = Store(tmp_path, "completions")
    with replying((200, data), EVENTS) as server:
        with refused(TransportError, got="1 of 1 requests failed after all tries"):
            list(RecordingLLM(hosted(server.url, provider, patience=QUICK), store).complete([request("a")]))
        assert len(server.bodies) == QUICK.tries
    assert list(store.entries()) == []


@pytest.mark.parametrize(
    ("provider", "stream"),
    [
        ("openai", lambda error: events(*HALVES, {"error": error}, *END)),
        ("openai", lambda error: events({"choices": [{"index": 0, "delta": {"content": ""}, "error": error}]})),
        ("openai", lambda error: b"event: error\n" + events({"error": error})),
        ("anthropic", lambda error: named(*PIECES[:7], {"type": "error", "error": error})),
    ],
)
@pytest.mark.parametrize(
    ("error", "tries"),
    [({"code": 503, "message": "no"}, QUICK.tries), ({"type": "authentication_error", "message": "no"}, 1)],
)
def test_error_in_a_stream_is_the_servers(
    stream: Callable[[Json], bytes], provider: str, error: Json, tries: int
) -> None:
    """Its code decides, as that of an error which comes alone."""
    with replying((200, stream(error)), EVENTS) as server:
        with refused(TransportError if tries > 1 else ConfigError, got="no"):
            list(hosted(server.url, provider, patience=QUICK).complete([request("a")]))
        assert len(server.bodies) == tries


def test_reasons_and_refusals_of_a_stream_are_read() -> None:
    """An answer that was cut off, or refused, is so in pieces, too."""
    assert read_chat(read_body(events(*HALVES, chunk(None, "length")))).stop_reason == "max_tokens"
    refusing = chunk()
    refusing["choices"][0]["delta"]["refusal"] = "I cannot"
    assert read_chat(read_body(events(refusing, *END))).stop_reason == "refusal"
    cut = {"type": "message_delta", "delta": {"stop_reason": "max_tokens"}, "usage": {"output_tokens": 20}}
    assert read_message(read_body(named(*PIECES[:-2], cut)), Delivery.direct).stop_reason == "max_tokens"


def test_stream_may_be_longer_than_an_answer_and_its_text_may_not() -> None:
    """Each word comes with hundreds of bytes; the limit of a text is that of every answer."""
    padding = "x" * 1000
    long = events(*(chunk("hi ", padding=padding) for _ in range(6000)), *END)
    assert len(long) > MOST_BYTES
    with replying((200, long), EVENTS) as server:
        ((_, answer),) = hosted(server.url, "openai", patience=QUICK).complete([request("a")])
        assert (answer.text, len(server.bodies)) == ("hi " * 6000, 1)
    with pytest.raises(FaultError, match="longer than"):
        read_body(events(*(chunk("x" * 2**20) for _ in range(5)), *END))


@given(st.lists(st.text(max_size=5), max_size=8), st.sampled_from(["\n", "\r\n", "\r"]), st.booleans())
def test_any_text_is_joined_as_it_was_divided(parts: list[str], line: str, bare: bool) -> None:
    """Also one that holds marks of streams, and every kind of line end."""
    said = [chunk(part) for part in ["data: [DONE]\u2028", *parts]]
    data = events(*said, *END, line=line)
    expected = "".join(["data: [DONE]\u2028", *parts])
    raw = json.dumps(chat(content=expected), ensure_ascii=False).encode("utf-8", errors="surrogatepass")
    read: list[Completion] = [read_chat(read_body(data))]
    if bare and expected.isprintable():
        read.append(read_chat(read_body(b"data: " + raw + b"\n\ndata: [DONE]")))
    assert [answer.text for answer in read] == [expected] * len(read)
