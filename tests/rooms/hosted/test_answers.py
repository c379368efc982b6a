"""Promise: a text that a server gave is kept, whatever stands beside it; what is not known there is unknown.

The real SDKs read the bodies from a real server; what they hold is shaped as servers of others have sent it.
"""

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from asked import request
from hosted import QUICK, hosted
from raw_server import replying
from refusals import refused

from tacevo.costs import in_words, spending_on
from tacevo.errors import StoreError, TransportError
from tacevo.llm.bodies import read_body, read_chat, read_message
from tacevo.llm.recording import RecordingLLM, ever_answered
from tacevo.llm.retry import FaultError, FaultKind
from tacevo.records import Completion, Delivery, Json, Mode, Price, to_json
from tacevo.storage.store import Store

pytestmark = pytest.mark.usefixtures("keys")

USAGE = {"prompt_tokens": 10, "completion_tokens": 20, "total_tokens": 30}
COUNTS = {"input_tokens": 10, "output_tokens": 20}


def chat(**fields: Any) -> dict[str, Any]:
    """Write an answer of the chat-completions API; `content` and `finish_reason` are those of its choice."""
    choice = {
        "index": 0,
        "message": {"role": "assistant", "content": fields.pop("content", "hi")},
        "finish_reason": fields.pop("finish_reason", "stop"),
    }
    return {"object": "chat.completion", "model": "m1", "choices": [choice], "usage": USAGE, **fields}


def message(**fields: Any) -> dict[str, Any]:
    """Write an answer of the Messages API."""
    content = [{"type": "text", "text": "hi"}]
    answer = {"type": "message", "role": "assistant", "model": "m1", "content": content, "stop_reason": "end_turn"}
    return {**answer, "usage": COUNTS, **fields}


def without(body: dict[str, Any], name: str) -> dict[str, Any]:
    """Return a body that lacks a field."""
    return {key: value for key, value in body.items() if key != name}


#: What may stand where a number of tokens should.
NO_COUNTS: list[Json] = [None, "20", True, -1, 20.5, 20.0, 10**30, [], {}]

NO_USAGES: list[Json] = [None, 5, [], {}]

#: Choices and contents without a text.
NO_CHOICES: list[Json] = [[], None, 5, {"0": "text"}, ["text"], [None], [{}], [{"message": None}], [{"message": {}}]]
NO_CONTENTS: list[Json] = [None, 5, {}, True]
NO_BODIES: list[Json] = ["text", 5, None, [], {}]

#: Bodies whose tokens are not known, by the provider that has them.
UNCOUNTED: list[tuple[str, dict[str, Any]]] = [
    *(("openai", chat(usage=usage)) for usage in NO_USAGES),
    ("openai", chat(usage={"prompt_tokens": 10, "total_tokens": 10})),
    *(("openai", chat(usage={**USAGE, "prompt_tokens": value})) for value in NO_COUNTS),
    *(("openai", chat(usage={**USAGE, "completion_tokens": value})) for value in NO_COUNTS),
    ("openai", without(chat(), "usage")),
    *(("anthropic", message(usage=usage)) for usage in NO_USAGES),
    ("anthropic", message(usage={"cache_read_input_tokens": 900})),
    *(("anthropic", message(usage={**COUNTS, "input_tokens": value})) for value in NO_COUNTS),
    *(("anthropic", message(usage={**COUNTS, "cache_read_input_tokens": value})) for value in NO_COUNTS[1:]),
    ("anthropic", without(message(), "usage")),
]


def read(provider: str, body: Json) -> Completion:
    """Read a body as a provider's."""
    return read_message(body, Delivery.direct) if provider == "anthropic" else read_chat(body)


@pytest.mark.parametrize(("provider", "body"), UNCOUNTED)
def test_unknown_tokens_cost_no_answer(provider: str, body: dict[str, Any]) -> None:
    """The text is kept, and neither tokens nor cost are a number."""
    completion = read(provider, body)
    assert (completion.text, completion.tokens) == ("hi", None)
    priced = Price(input_usd=1.0, output_usd=5.0, dated="2026-11-21")
    spent = spending_on([replace(completion, price=priced)])
    assert (spent.unpriced, spent.uncounted) == (1, 1)
    assert in_words(spent) == "1 answer, tokens unknown, price unknown"


@pytest.mark.parametrize(
    ("provider", "body"),
    [
        ("openai", chat(usage={"prompt_tokens": None, "completion_tokens": None})),
        ("openai", chat(usage={"prompt_tokens": True, "completion_tokens": 20})),
        ("openai", chat(model=None)),
        ("openai", chat(content=[{"type": "thinking", "thinking": [{"type": "text", "text": "no"}]}, "hi"])),
        ("anthropic", without(message(), "usage")),
        ("anthropic", message(model=5, usage={"input_tokens": 10**30, "output_tokens": -1})),
    ],
)
def test_answer_is_asked_for_once_and_found_again(
    provider: str, body: dict[str, Any], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """It is paid for once and stored once; a replay reads it, and what is unknown is said once."""
    store = Store(tmp_path, "completions")
    asked = [request("a"), request("b")]
    with replying((200, body)) as server:
        answers = dict(RecordingLLM(hosted(server.url, provider, patience=QUICK), store).complete(asked))
        assert len(server.bodies) == 2
    assert {answer.text for answer in answers.values()} == {"hi"}
    assert dict(RecordingLLM(None, Store(tmp_path, "completions", Mode.replay)).complete(asked)) == answers
    told = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    unknown = [answers[0].model == "", answers[0].tokens is None]
    assert len(told) == sum(unknown)


@pytest.mark.parametrize("data", [b"\xef\xbb\xbf%s", b"\n\n %s \n"])
@pytest.mark.parametrize("media", ["text/plain", "application/octet-stream"])
def test_media_type_and_mark_decide_nothing(data: bytes, media: str) -> None:
    """JSON is JSON, whatever a proxy calls it."""
    body = b'{"choices":[{"message":{"content":"hi \xff"},"finish_reason":"stop"}],"usage":{"prompt_tokens":%s}}'
    with replying((200, data % (body % (b"9" * 5_000))), {"content-type": media}) as server:
        ((_, completion),) = hosted(server.url, "openai", patience=QUICK).complete([request("a")])
        assert len(server.bodies) == 1
    assert (completion.text, completion.tokens) == ("hi \ufffd", None)


@pytest.mark.parametrize("body", [chat(model=None), chat(model={"name": "m"}), without(chat(), "model")])
def test_unnamed_model_is_unnamed(body: Json) -> None:
    """No other name is put in its place."""
    assert read_chat(body).model == ""


PART = {"type": "text", "text": "hi"}


@pytest.mark.parametrize(
    "content",
    [
        [PART],
        PART,
        ["hi"],
        [{"type": "output_text", "text": "hi", "annotations": []}],
        [{"text": "hi"}],
        [{"type": "text", "text": {"value": "hi", "annotations": []}}],
        [{"type": "thinking", "thinking": "no"}, PART, {"type": "tool_use", "text": "no"}, None, 5, {}],
        [{"type": "text", "text": "h"}, [{"type": "text", "text": "i"}]],
        [{"type": "text", "text": [{"type": "text", "text": "hi"}]}],
    ],
)
def test_text_is_found_in_its_parts(content: Json) -> None:
    """Parts of all kinds that hold text are joined in their order; thoughts and tools are none."""
    assert read_chat(chat(content=content)).text == "hi"
    assert read_message(message(content=content), Delivery.direct).text == "hi"


@pytest.mark.parametrize(
    ("finish", "stop_reason"),
    [
        ("stop", "end_turn"),
        ("length", "max_tokens"),
        ("content_filter", "refusal"),
        ("tool_calls", "tool_calls"),
        (None, "end_turn"),
        ("", "end_turn"),
        (5, "end_turn"),
    ],
)
def test_stop_reasons_are_those_of_the_gate(finish: Json, stop_reason: str) -> None:
    """What the Messages API has a name for gets that name; the rest is kept, and nonsense is no reason."""
    assert read_chat(chat(finish_reason=finish)).stop_reason == stop_reason
    assert read_message(message(stop_reason=5), Delivery.direct).stop_reason == "end_turn"


REFUSING = chat(content=None)
REFUSING["choices"][0]["message"]["refusal"] = "I cannot"


@pytest.mark.parametrize(
    ("provider", "body", "stop_reason"),
    [
        ("openai", REFUSING, "refusal"),
        ("openai", chat(content=[{"type": "refusal", "refusal": "I cannot"}]), "refusal"),
        ("openai", chat(content=None, finish_reason="length"), "max_tokens"),
        ("anthropic", message(content=[]), "end_turn"),
    ],
)
def test_answer_without_a_text_counts_where_it_says_why(provider: str, body: Json, stop_reason: str) -> None:
    """A model refused, or used up its limit to think; asking again would not help."""
    completion = read(provider, body)
    assert (completion.text, completion.stop_reason) == ("", stop_reason)


@pytest.mark.parametrize(
    ("provider", "body"),
    [
        *(("openai", chat(choices=choices)) for choices in NO_CHOICES),
        ("openai", chat(content=5)),
        ("openai", chat(content=None, finish_reason=None)),
        *(("anthropic", message(content=content)) for content in NO_CONTENTS),
        ("anthropic", without(message(), "content")),
        *((provider, body) for provider in ("openai", "anthropic") for body in NO_BODIES),
    ],
)
def test_missing_text_is_asked_for_again(provider: str, body: Json) -> None:
    """It is not recorded: a server may answer properly the next time."""
    with pytest.raises(FaultError) as caught:
        read(provider, body)
    assert caught.value.fault.kind is FaultKind.passing


@pytest.mark.parametrize("provider", ["openai", "anthropic"])
def test_deep_body_is_an_error_and_no_traceback(provider: str) -> None:
    """200,000 brackets, alone and where content should be, end like every other body that is not an answer."""
    field = b'{"choices":[{"message":{"content":%s}}]}' if provider == "openai" else b'{"content":%s}'
    for data in (b"[" * 200_000, field % (b"[" * 200_000 + b"]" * 200_000)):
        with replying((200, data)) as server, refused(TransportError, got="nested too deeply"):
            list(hosted(server.url, provider, patience=QUICK).complete([request("a")]))
    deep: Json = "hi"
    for _ in range(600):
        deep = [deep]
    assert read_chat(chat(content=deep)).text == ""
    assert read_body(b"[[[]]]") == [[[]]]


#: 10 new tokens, 900 read from the cache and 500 written there; a chat-completions server counts all of them first.
CACHED = [
    ("anthropic", message(usage={**COUNTS, "cache_read_input_tokens": 900, "cache_creation_input_tokens": 500})),
    (
        "openai",
        chat(
            usage={
                "prompt_tokens": 1410,
                "completion_tokens": 20,
                "prompt_tokens_details": {"cached_tokens": 900},
                "cache_creation_input_tokens": 500,
            }
        ),
    ),
]


@pytest.mark.parametrize(("provider", "body"), CACHED)
def test_cached_tokens_have_prices_of_their_own(provider: str, body: dict[str, Any]) -> None:
    """By hand: 10 + 900 / 10 + 500 * 1.25 input tokens at 1 dollar a million, and 20 output tokens at 5 dollars."""
    completion = read(provider, body)
    assert completion.tokens == (1410, 20)
    price = Price(input_usd=1.0, output_usd=5.0, dated="2026-11-21", cache_read_usd=0.1, cache_write_usd=1.25)
    assert replace(completion, price=price).cost == pytest.approx(825e-6)
    plain = Price(input_usd=1.0, output_usd=5.0, dated="2026-11-21")
    assert replace(completion, price=plain).cost is None


@pytest.mark.parametrize(
    "usage",
    [
        {**COUNTS, "cache_creation_input_tokens": 500, "cache_creation": {"ephemeral_1h_input_tokens": 500}},
        {**COUNTS, "cache_read_input_tokens": "900"},
    ],
)
def test_cached_tokens_of_unknown_price_have_no_cost(usage: dict[str, Any]) -> None:
    """What is kept for an hour has another price; what is no number has none."""
    price = Price(input_usd=1.0, output_usd=5.0, dated="2026-11-21", cache_read_usd=0.1, cache_write_usd=1.25)
    completion = read_message(message(usage=usage), Delivery.direct)
    assert replace(completion, price=price).cost is None


def test_new_fields_are_not_written_where_they_say_nothing() -> None:
    """An answer of a plain kind is the entry that earlier versions wrote, so that stores can be joined."""
    kept = to_json(read_chat(chat()))
    assert list(kept) == [
        *("text", "model", "stop_reason", "input_tokens", "output_tokens", "dropped", "delivery", "price")
    ]
    assert to_json(Price(input_usd=1.0, output_usd=5.0, dated="2026-11-21")).keys() == {
        *("input_usd", "output_usd", "dated", "factor")
    }


def test_counts_that_an_earlier_version_kept_are_read(tmp_path: Path) -> None:
    """It wrote `true`, and could not read it; the answer is found, with its hash, and its tokens are unknown."""
    store = Store(tmp_path, "completions")
    counts: dict[str, Json] = {"input_tokens": True, "output_tokens": 10**30}
    kept = {"text": "hi", "model": "m", "stop_reason": "end_turn", **counts}
    store.write(to_json(request("a")), kept)
    ((_, completion),) = RecordingLLM(None, store).complete([request("a")])
    assert completion.tokens is None
    assert completion.content() == kept


def test_entry_that_cannot_be_read_is_named_and_stops_no_other_request(tmp_path: Path) -> None:
    """Its own request names the file to delete; who only looks for evidence passes over it."""
    store = Store(tmp_path, "completions")
    store.write(to_json(request("a")), {"text": 5})
    store.write(to_json(request("b")), to_json(read_chat(chat())))
    (tmp_path / "completions" / "00").mkdir(exist_ok=True)
    (tmp_path / "completions" / "00" / "torn.json").write_text("{")
    assert ever_answered(store, request("c"))
    path = store.path(store.key(to_json(request("a"))))
    with replying((200, chat())) as server:
        llm = RecordingLLM(hosted(server.url, "openai", patience=QUICK), store)
        with refused(StoreError, place=str(path), remedy="delete that file"):
            list(llm.complete([request("a")]))
        path.unlink()
        assert [answer.text for _, answer in llm.complete([request("a")])] == ["hi"]
