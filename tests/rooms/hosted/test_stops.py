"""Promise: what a server marks as failed is never recorded, and what it marks as cut off is known as such.

The words are those of real servers: OpenAI, Azure, vLLM, SGLang, TGI, llama.cpp, Ollama, LM Studio, TensorRT, Mistral,
DeepSeek, Gemini, Cohere, Bedrock, Zhipu, watsonx, and of Anthropic.
"""

from pathlib import Path
from typing import Any

import pytest
from asked import request
from hosted import PROVIDERS, QUICK, batched, hosted
from llm_server import serving
from raw_server import Reply, replying
from refusals import refused
from test_answers import chat, message

from tacevo.errors import TransportError
from tacevo.gate.extraction import CUT_OFF
from tacevo.llm.recording import RecordingLLM
from tacevo.llm.retry import FaultError, FaultKind
from tacevo.llm.stops import UNKNOWN, stop_reason_of
from tacevo.records import Json
from tacevo.storage.store import Store

pytestmark = pytest.mark.usefixtures("keys")
both = pytest.mark.parametrize("provider", PROVIDERS)

FINISHED: tuple[Any, ...] = (
    *("stop", "STOP", "Stop", "FinishReason.STOP", "FINISH_REASON_STOP", "end_turn", "END_TURN", "endTurn", "eos"),
    *("eos_token", "eosFound", "EOS", "COMPLETE", "completed", "end_id", "stop_sequence", "stop_words", "tool_calls"),
    *(
        "stop_token_ids",
        "stop_str",
        "eos_token_id",
        "end_of_text",
        "STOP_SEQUENCE",
        "stopStringFound",
        "function_call",
        "tool_use",
        "TOOL_CALL",
        None,
        "",
        "null",
        5,
        [],
        {},
    ),
    {"type": "stop", "matched": 128009},
)

CUT = (
    *("length", "LENGTH", "max_tokens", "MAX_TOKENS", "max-tokens", "FinishReason.MAX_TOKENS", "model_length"),
    *(
        "max_output_tokens",
        "max_new_tokens",
        "max_completion_tokens",
        "token_limit",
        "limit",
        "MAX_LENGTH",
        "truncated",
    ),
    *("model_context_window_exceeded", "context_length_exceeded", "contextLengthReached", "ERROR_LIMIT", "time_limit"),
    *("maxPredictedTokensReached", "REASON_MAX_LEN", "max_len_reached", {"type": "length", "length": 77}),
)

REFUSED = (
    *("content_filter", "CONTENT_FILTER", "contentFiltered", "content_filtered", "SAFETY", "RECITATION", "BLOCKLIST"),
    *("PROHIBITED_CONTENT", "SPII", "IMAGE_SAFETY", "refusal", "sensitive", "guardrail_intervened", "ERROR_TOXIC"),
    *("blocked", "flagged", "moderation"),
)

FAILED = (
    *("error", "ERROR", "abort", "aborted", "cancelled", "canceled", "USER_CANCEL", "insufficient_system_resource"),
    *("timeout", "timed_out", "TIMEOUT", "network_error", "internal_server_error", "failed", "MALFORMED_FUNCTION_CALL"),
    *("malformed_model_output", "model_unloaded", "userStopped", "rate_limit", "service_unavailable", "interrupted"),
    {"type": "abort", "message": "the client went away"},
)

ODD = (
    "pause_turn",
    "OTHER",
    "LANGUAGE",
    "FINISH_REASON_UNSPECIFIED",
    "repetition",
    "load",
    "not_finished",
    "停止",
    "?",
)


@pytest.mark.parametrize(
    ("said", "reasons"),
    [
        *((said, {"end_turn", "stop_sequence", "tool_use", "tool_calls", "function_call"}) for said in FINISHED),
        *((said, CUT_OFF - {UNKNOWN}) for said in CUT),
        *((said, {"refusal"}) for said in REFUSED),
        *((said, {UNKNOWN}) for said in ODD),
    ],
)
def test_word_of_any_server_is_one_that_the_gate_knows(said: Json, reasons: set[str]) -> None:
    """Whatever its case and signs; one that nobody knows is that of an answer that may be cut off."""
    assert stop_reason_of(said) in reasons
    assert UNKNOWN in CUT_OFF


@pytest.mark.parametrize("said", FAILED)
def test_answer_that_failed_is_none(said: Json) -> None:
    """It is asked for again, as where a server is overloaded."""
    with pytest.raises(FaultError) as caught:
        stop_reason_of(said)
    assert caught.value.fault.kind is FaultKind.passing


def failed_bodies(provider: str) -> list[dict[str, Any]]:
    """Write answers with a text that their server marks as failed."""
    error = {"code": 502, "message": "the upstream host went away"}
    if provider == "anthropic":
        return [message(stop_reason="error"), message(stop_reason="abort"), message(error=error)]
    bodies = [chat(finish_reason=said) for said in ("error", "abort", "insufficient_system_resource")]
    for said in ("error", "stop", None):
        bodies.append(chat(finish_reason=said, content="half of a"))
        bodies[-1]["choices"][0]["error"] = error
    inner = chat(content="")
    inner["choices"][0]["message"]["error"] = error
    return [*bodies, inner, chat(error=error), chat(error="the upstream host went away")]


@both
def test_failed_answer_is_asked_for_again_and_the_next_one_is_recorded(provider: str, tmp_path: Path) -> None:
    """Once for each failure, and once for the answer; the failed text stands nowhere."""
    for number, failed in enumerate(failed_bodies(provider)):
        sound = message() if provider == "anthropic" else chat()

        def reply(body: object, tried: int, failed: Any = failed, sound: Any = sound) -> Reply:
            return 200, failed if tried < 2 else sound

        store = Store(tmp_path / str(number), "completions")
        with replying(reply) as server:
            ((_, answer),) = RecordingLLM(hosted(server.url, provider, patience=QUICK), store).complete([request("a")])
            assert (answer.text, answer.stop_reason, len(server.bodies)) == ("hi", "end_turn", 3), failed


@both
def test_answer_that_fails_at_every_try_is_not_recorded(provider: str, tmp_path: Path) -> None:
    """The run stops, and the same command asks again."""
    store = Store(tmp_path, "completions")
    with replying((200, failed_bodies(provider)[0])) as server:
        with refused(TransportError, got="1 of 1 requests failed after all tries"):
            list(RecordingLLM(hosted(server.url, provider, patience=QUICK), store).complete([request("a")]))
        assert len(server.bodies) == QUICK.tries
    assert list(store.entries()) == []


@both
@pytest.mark.parametrize("error", [None, {}, "", False, {"code": None, "message": ""}, {"code": 0, "message": ""}])
def test_error_that_says_nothing_is_none(error: Json, provider: str) -> None:
    """Some servers send the field with every answer."""
    body = message(error=error) if provider == "anthropic" else chat(error=error)
    if provider == "openai":
        body["choices"][0]["error"] = error
    with replying((200, body)) as server:
        ((_, answer),) = hosted(server.url, provider, patience=QUICK).complete([request("a")])
        assert (answer.text, len(server.bodies)) == ("hi", 1)


def test_unknown_word_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    """The answers are kept, and a user learns why they may be rejected."""
    with replying((200, chat(finish_reason="whatever"))) as server:
        answers = list(hosted(server.url, "openai", patience=QUICK).complete([request("a"), request("b")]))
    assert {answer.stop_reason for _, answer in answers} == {UNKNOWN}
    assert caplog.text.count("cut off") == 1


def test_failed_answer_of_a_batch_is_submitted_again(tmp_path: Path) -> None:
    """A batch has the same words; the others of it are kept."""
    with serving() as server:
        answers = batched(server.url, tmp_path).complete([request("a"), request("b [fault stopped]")])
        assert next(answers)[1].text == "a!"
        with refused(TransportError, got="1 of 2 requests failed"):
            next(answers)
    assert [len(batch.requests) for batch in server.batches] == [2, 1, 1]
