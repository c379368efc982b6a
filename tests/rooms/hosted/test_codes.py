"""Promise: what an error means follows from its words and the code in it, whatever status a router gave it.

One refused request does not stop a run; what is about key, account or model does, in one line. The bodies are shaped as
those of OpenAI, Azure, Anthropic, OpenRouter, LiteLLM, vLLM, llama.cpp, SGLang, TGI, Gemini, Mistral, Groq, DashScope.
"""

import json
from pathlib import Path

import pytest
from asked import request
from hosted import PROVIDERS, QUICK, batched, hosted
from llm_script import text_of
from llm_server import serving
from raw_server import Reply, replying
from refusals import refused
from test_answers import chat, message

from tacevo.errors import ConfigError, TransportError
from tacevo.llm.recording import RecordingLLM
from tacevo.llm.retry import FaultKind, fault_of_body, fault_of_status
from tacevo.records import Json
from tacevo.storage.canonical import value_at
from tacevo.storage.store import Store

pytestmark = pytest.mark.usefixtures("keys")
both = pytest.mark.parametrize("provider", PROVIDERS)

RAW = json.dumps({"error": {"message": "This model's maximum context length is 4096 tokens. You requested 5210."}})

#: Errors about one request that is too long, with the statuses that they came with.
TOO_LONG: list[tuple[int, Json]] = [
    (500, {"error": {"message": "ContextWindowExceeded: the messages have 5210 tokens", "type": None, "code": "500"}}),
    (500, {"error": {"message": "the request exceeds the available context size, try increasing it"}}),
    (500, {"error": "input length exceeds the maximum context length"}),
    (502, {"detail": "The input (5210 tokens) is longer than the model's context length (4096 tokens)."}),
    (400, {"error": {"message": "no", "type": "invalid_request_error", "code": "context_length_exceeded"}}),
    (
        400,
        {"error": {"message": "Provider returned error", "code": 400, "metadata": {"raw": RAW, "provider_name": "x"}}},
    ),
    (400, {"object": "error", "message": "The prompt (length 5210) is longer than the maximum model length of 4096"}),
    (400, [{"error": {"code": 400, "message": "The input token count (9) exceeds the maximum", "status": "INVALID"}}]),
    (400, {"error": "Bad Request", "message": "prompt is too long", "statusCode": 400}),
    (403, {"error": {"message": "maximum context length exceeded", "code": 403}}),
    (413, {"error": {"message": "Request too large for model: limit 6000 tokens", "code": "rate_limit_exceeded"}}),
    (413, "<html>Payload Too Large</html>"),
    (422, {"detail": [{"loc": ["body", "messages"], "msg": "input is too long", "type": "value_error"}]}),
    (200, {"error": {"message": "Input is too long for the requested model", "code": 400}}),
    (500, {"error": "Input validation error: `inputs` must have less than 4096 tokens. Given: 5210"}),
    (500, {"error": {"message": "Prompt token count of 5210 exceeds the limit of 4096", "code": None}}),
    (502, {"error": {"message": "Prompt exceeds max length", "code": "1261"}}),
    (200, {"error": "the prompt is too long: 250000 tokens > 200000 maximum"}),
]

#: Errors about one request that a filter holds back.
FILTERED: list[tuple[int, Json]] = [
    (403, {"error": {"code": 403, "message": "Your input was flagged by moderation", "metadata": {"reasons": ["x"]}}}),
    (403, {"error": {"message": 'openai/x requires moderation. Your input was flagged for "violence"', "code": 403}}),
    (400, {"error": {"code": "content_filter", "message": "The response was filtered due to the prompt triggering"}}),
    (400, {"error": {"code": None, "message": "no", "innererror": {"code": "ResponsibleAIPolicyViolation"}}}),
    (400, {"error": {"message": "Your request was rejected as a result of our safety system", "code": "x"}}),
    (400, {"error": {"message": "Invalid prompt: your prompt was flagged as violating our usage policy"}}),
    (400, {"error": {"message": "Output data may contain inappropriate content", "code": "data_inspection_failed"}}),
    (
        400,
        {"type": "error", "error": {"type": "invalid_request_error", "message": "Output blocked by content filtering"}},
    ),
    (422, {"detail": "the request was blocked by a guardrail"}),
    (500, {"error": {"message": "content_policy_violation: the prompt is refused", "code": "500"}}),
    (200, {"error": {"code": "content_policy_violation", "message": "no"}}),
]

#: Errors that pass, whatever status they came with.
FILTERED += [
    (403, {"code": "The caller does not have permission", "error": "Content violates usage guidelines. SAFETY_CHECK"}),
    (200, {"choices": None, "base_resp": {"status_code": 1026, "status_msg": "input new_sensitive"}}),
]

PASSING: list[tuple[int, Json]] = [
    (200, {"error": {"code": 429, "message": "slow down"}}),
    (200, {"error": {"code": "503", "message": "no"}}),
    (200, {"error": {"error": {"status": 502}}}),
    (200, {"error": {"type": "overloaded_error", "message": "Overloaded"}}),
    (200, {"code": 500, "message": "no"}),
    (200, {"detail": "it is busy"}),
    (400, {"error": {"message": "Provider returned error", "code": 502}}),
    (400, {"error": {"code": 429, "message": "rate limited upstream"}}),
    (400, {"error": {"type": "rate_limit_error", "message": "no"}}),
    (403, {"error": {"code": 503, "message": "no"}}),
    (424, {"error": "Request failed during generation", "error_type": "generation"}),
    (500, {"error": {"message": "You exceeded the maximum of 9000 input tokens per minute"}}),
    (429, {"error": {"message": "Too many tokens, the prompt queue is too long"}}),
    (500, {"error": {"message": "the queue is too long"}}),
    (500, {"error": {"message": "the content filter is temporarily unavailable"}}),
    (503, {"error": {"message": "the server is overloaded: context window manager"}}),
    (503, {"error": {"message": "model m not found on this node, it is loading: try again later"}}),
    (529, {"type": "error", "error": {"type": "overloaded_error", "message": "Overloaded"}}),
]

#: Errors about key, account, payment or model, and what the message says to do.
FINAL: list[tuple[int, Json]] = [
    (
        401,
        {
            "error": {
                "message": "Incorrect API key provided",
                "type": "invalid_request_error",
                "code": "invalid_api_key",
            }
        },
    ),
    (200, {"error": {"code": 401, "message": "No auth credentials found"}}),
    (400, {"error": {"code": "invalid_api_key", "message": "no"}}),
    (500, {"error": {"type": "authentication_error", "message": "litellm.AuthenticationError: no"}}),
    (403, {"error": {"message": "Your account was flagged for a violation of our usage policies"}}),
    (403, {"error": {"message": "Country, region, or territory not supported", "type": "request_forbidden"}}),
    (403, {"error": {"message": "no", "type": "invalid_request_error"}}),
    (402, {"error": {"message": "Insufficient Balance", "type": "unknown_error"}}),
    (429, {"error": {"message": "You exceeded your current quota", "code": "insufficient_quota"}}),
    (400, {"error": {"message": "Your credit balance is too low: the prompt is too long for it"}}),
    (200, {"error": {"code": 402, "message": "no credits"}}),
    (400, {"error": {"code": 400, "message": "API key not valid. Please pass a valid API key.", "status": "INVALID"}}),
    (500, {"error": {"message": "Incorrect API key provided: sk-xxxx", "code": "500"}}),
    (500, {"error": "Insufficient credits"}),
    (
        429,
        {"error": {"message": "Your account o-1 is suspended, see your plan", "type": "exceeded_current_quota_error"}},
    ),
    (200, {"choices": None, "base_resp": {"status_code": 1008, "status_msg": "insufficient balance"}}),
    (200, {"choices": None, "base_resp": {"status_code": 1004, "status_msg": "login fail: no key"}}),
    (400, {"code": "Arrearage", "message": "Access denied, please make sure your account is in good standing."}),
    (200, {"detail": "Not authenticated"}),
]

LACKING: list[tuple[int, Json]] = [
    (404, {"error": {"message": "The model `m` does not exist", "code": "model_not_found"}}),
    (400, {"error": {"message": "the requested model is not supported", "code": "model_not_supported"}}),
    (200, {"error": {"code": 404, "message": "No endpoints found for this model"}}),
    (500, {"error": {"message": "model 'm' not found", "type": "not_found_error"}}),
    (400, {"error": {"message": "m is not a valid model ID", "code": 400}}),
    (500, {"error": "model 'm' not found, try pulling it first"}),
    (200, {"error": "The model `m` does not exist"}),
]

#: Refusals of which nobody can tell whether they are about one request.
DOUBTFUL: list[tuple[int, Json]] = [
    (400, {"error": {"message": "messages.0: this is not understood", "type": "invalid_request_error"}}),
    (500, {"error": {"message": "messages.0: this is not understood", "type": "invalid_request_error"}}),
    (502, {"error": {"message": "litellm.BadRequestError: no", "code": "400"}}),
    (200, {"error": {"message": "no", "code": 422}}),
    (400, {"error": {"message": "Invalid special token in messages.0; this model does not support top_k"}}),
    (200, {"error": {"message": "no", "type": "BadRequestError"}}),
    (400, {"error": {"message": "no", "code": "9" * 5_000}}),
]


@pytest.mark.parametrize(
    ("errors", "kind", "reason"),
    [
        (TOO_LONG, FaultKind.request, "invalid_request"),
        (FILTERED, FaultKind.request, "refusal"),
        (PASSING, FaultKind.passing, ""),
        (FINAL, FaultKind.refused, ""),
        (LACKING, FaultKind.unknown, ""),
        (DOUBTFUL, FaultKind.doubtful, "invalid_request"),
    ],
)
def test_words_and_codes_decide_what_follows(errors: list[tuple[int, Json]], kind: FaultKind, reason: str) -> None:
    """A status of 200, 400, 403 or 500 and more says little; the words and the code beside it say the rest."""
    for status, body in errors:
        fault = fault_of_body(body) if status == 200 else fault_of_status(status, {}, body)
        assert fault.kind is kind, (status, body)
        assert not reason or fault.stop_reason == reason, (status, body)


@both
def test_request_that_is_refused_for_good_stops_no_run(provider: str, tmp_path: Path) -> None:
    """It is asked once, recorded in place of an answer, and the others are answered; also in the next command."""
    sound = message() if provider == "anthropic" else chat()
    for errors, reason in ((TOO_LONG, "invalid_request"), (FILTERED, "refusal"), (DOUBTFUL, "invalid_request")):
        for number, (status, refusal) in enumerate(errors):

            def reply(body: Json, tried: int, status: int = status, refusal: Json = refusal) -> Reply:
                return (status, refusal) if text_of(body) == "odd" else (200, sound)  # type: ignore[arg-type]

            store = Store(tmp_path / f"{reason}-{len(errors)}-{number}", "completions")
            asked = [request(text) for text in ("a", "odd", "b")]
            with replying(reply) as server:
                for _ in range(2):
                    llm = RecordingLLM(hosted(server.url, provider, concurrency=1, patience=QUICK), store)
                    answers = dict(llm.complete(asked))
                assert len(server.bodies) == 3, (status, refusal)
            assert [answers[place].stop_reason for place in range(3)] == ["end_turn", reason, "end_turn"]
            assert len(list(store.entries())) == 3


@pytest.mark.slow
@both
def test_what_no_request_can_mend_stops_the_run_in_one_line(provider: str) -> None:
    """It is asked once, and what is wrong is said in the server's words."""
    for status, refusal in FINAL + LACKING:
        body = json.dumps(refusal).encode()
        with replying((status, body)) as server:
            with refused(ConfigError) as caught:
                list(hosted(server.url, provider, patience=QUICK).complete([request("a")]))
            assert len(server.bodies) == 1, (status, refusal)
        assert "\n" not in str(caught.value)


@pytest.mark.slow
@both
def test_what_passes_is_asked_again(provider: str, tmp_path: Path) -> None:
    """Also where a router says so in a body of another status; nothing of it is recorded."""
    store = Store(tmp_path, "completions")
    for status, refusal in PASSING:
        with replying((status, json.dumps(refusal).encode())) as server:
            with refused(TransportError, got="1 of 1 requests failed after all tries"):
                list(RecordingLLM(hosted(server.url, provider, patience=QUICK), store).complete([request("a")]))
            assert len(server.bodies) == QUICK.tries, (status, refusal)
    assert list(store.entries()) == []


@pytest.mark.parametrize(("text", "reason"), [("[fault too_long]", "invalid_request"), ("[fault filtered]", "refusal")])
def test_batches_have_the_same_rule(text: str, reason: str, tmp_path: Path) -> None:
    """An error within a batch has a type, and no status."""
    with serving() as server:
        answers = dict(batched(server.url, tmp_path).complete([request("a"), request(text)]))
    assert answers[1].stop_reason == reason


@both
def test_error_that_comes_as_an_event_is_read(provider: str) -> None:
    """Its code decides, too; what an SDK leaves out of a body is not lost."""
    for body in (b'data: {"error": {"code": 401, "message": "no"}}\n\ndata: [DONE]', b'{"error": null, "code": 401}'):
        with replying((500, body)) as server, refused(ConfigError, got="401"):
            list(hosted(server.url, provider, patience=QUICK).complete([request("a")]))


def test_codes_that_are_no_status_say_nothing() -> None:
    """Numbers of a server's own, flags and whatever stands deep within what it repeats."""
    for code in (0, 20, 1301, "40001", True, "x" * 400, None, -400, 4.0, [503], {"code": {"code": 503}}):
        assert fault_of_status(400, {}, {"error": {"message": "no", "code": code}}).kind is FaultKind.doubtful
    assert fault_of_status(400, {}, {"error": {"message": "no", "input": {"code": 503}}}).kind is FaultKind.doubtful


def test_recorded_refusal_names_what_was_refused(tmp_path: Path) -> None:
    """A stop reason that the gate knows, without a text, and the model that was asked."""
    store = Store(tmp_path, "completions")

    def reply(body: Json, tried: int) -> Reply:
        return FILTERED[0] if text_of(body) == "odd" else (200, chat())  # type: ignore[arg-type]

    with replying(reply) as server:
        list(RecordingLLM(hosted(server.url, "openai"), store).complete([request("a"), request("odd")]))
    reasons = sorted(str(value_at(entry.answer, ("stop_reason",))) for entry in store.entries())
    assert reasons == ["end_turn", "refusal"]
