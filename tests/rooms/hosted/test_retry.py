"""Promise: every fault has one consequence, whatever the provider; waits are bounded and honour the server's word."""

import math
from email.utils import formatdate

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacevo.llm.retry import SAMPLING, Fault, FaultKind, Patience, fault_of_status, setting_to_drop
from tacevo.records import Json

PASSING = Fault(kind=FaultKind.passing, message="529: busy")


def refusal(words: str, status: int = 400, **error: str) -> Fault:
    """Read a refusal with these words."""
    return fault_of_status(status, {}, {"type": "error", "error": {"message": words, **error}}, path="/v1/messages")


@pytest.mark.parametrize(
    ("status", "words", "kind"),
    [
        *((status, "try later", FaultKind.passing) for status in (408, 409, 429, 500, 502, 503, 504, 529)),
        *((status, "no", FaultKind.refused) for status in (401, 402, 403, 404, 405)),
        (404, "model: claude-3-haiku-20240307", FaultKind.unknown),
        (404, "The model `x` does not exist or you do not have access to it.", FaultKind.unknown),
        (404, "model 'x' not found, try pulling it first", FaultKind.unknown),
        (404, "Not Found", FaultKind.refused),
        *((status, "no such thing", FaultKind.doubtful) for status in (400, 422)),
        (413, "request exceeds the maximum size", FaultKind.request),
        (400, "prompt is too long: 9 tokens > 8 maximum", FaultKind.request),
        (400, "This model's maximum context length is 8192 tokens", FaultKind.request),
        (400, "The system prompt is too long", FaultKind.request),
        (400, "You exceed the limit of 9000 tokens per minute", FaultKind.doubtful),
        (400, "Output blocked by content filtering policy", FaultKind.request),
        (400, "Your credit balance is too low", FaultKind.refused),
        (
            400,
            "You have reached your specified API usage limits. You will regain access on 2026-12-01",
            FaultKind.refused,
        ),
        (400, "This organization has been disabled.", FaultKind.refused),
        (429, "Rate limit reached; add a payment method at https://x.test/account/billing", FaultKind.passing),
        (429, "This would exceed your organization's usage limits per minute", FaultKind.passing),
        (400, "Check your plan and billing details", FaultKind.refused),
        (429, "You exceeded your current quota (insufficient_quota)", FaultKind.refused),
    ],
)
def test_status_and_words_decide_what_follows(status: int, words: str, kind: FaultKind) -> None:
    """What passes is asked again, what is about one request is recorded, what is about the account stops the run."""
    assert refusal(words, status).kind is kind


def test_filtered_request_ends_as_a_refusal_and_a_long_one_as_invalid() -> None:
    """The completion in place of an answer says why there is none."""
    assert refusal("Output blocked by content filtering policy").stop_reason == "refusal"
    assert refusal("prompt is too long").stop_reason == "invalid_request"


@pytest.mark.parametrize("body", [None, "", "<html>bad gateway</html>", {}, {"error": "plain"}, {"error": None}, []])
def test_any_body_is_read(body: Json) -> None:
    """A proxy may answer with anything."""
    fault = fault_of_status(502, {}, body, path="/")
    assert fault.kind is FaultKind.passing
    assert fault.message.startswith("502: ")


@pytest.mark.parametrize(
    ("value", "seconds"),
    [("7", 7.0), ("0.5", 0.5), ("120", 120.0), ("-3", 0.0), ("soon", None), ("nan", None), ("inf", None), ("", None)],
)
def test_retry_after_is_read_in_seconds(value: str, seconds: float | None) -> None:
    """A number counts, also above a minute; what makes no sense is as good as nothing."""
    assert fault_of_status(429, {"retry-after": value}, None, path="/").retry_after == seconds


def test_retry_after_is_read_as_a_date() -> None:
    """HTTP allows a date, too; one in the past asks for no wait."""
    assert fault_of_status(429, {"retry-after": formatdate(0, usegmt=True)}, None, path="/").retry_after == 0.0
    far = fault_of_status(429, {"retry-after": formatdate(4e9, usegmt=True)}, None, path="/").retry_after
    assert far is not None
    assert far > 1e6


@given(tried=st.integers(1, 10_000), jitter=st.floats(0, 1, exclude_max=True))
def test_waits_are_bounded(tried: int, jitter: float) -> None:
    """However often a request was tried, the next wait is finite, positive and no longer than the longest."""
    wait = Patience(tries=20_000, first=0.5, longest=60).wait(tried, PASSING, jitter=jitter)
    assert wait is not None
    assert 0 < wait <= 60


def test_wait_doubles_and_the_servers_word_counts_more() -> None:
    """Without a word of the server the wait doubles; with one, no try comes before it."""
    patience = Patience(first=0.5, longest=60)
    assert [patience.wait(tried, PASSING, jitter=0) for tried in (1, 2, 3, 9)] == [0.5, 1.0, 2.0, 60.0]
    asked = Fault(kind=FaultKind.passing, message="", retry_after=90.0)
    assert patience.wait(1, asked, jitter=0) == 90.0
    assert patience.wait(1, asked, jitter=0.999) > 90.0  # type: ignore[operator]


@pytest.mark.parametrize(
    ("tried", "fault"),
    [
        (10, PASSING),
        (1, Fault(kind=FaultKind.passing, message="", retry_after=3601.0)),
        (1, Fault(kind=FaultKind.refused, message="")),
        (1, Fault(kind=FaultKind.doubtful, message="")),
        (1, Fault(kind=FaultKind.request, message="")),
    ],
)
def test_some_faults_are_not_waited_for(tried: int, fault: Fault) -> None:
    """The last try, a wait of hours, and whatever will not pass."""
    assert Patience(tries=10).wait(tried, fault, jitter=0) is None


def test_patience_outlasts_a_short_outage() -> None:
    """Without jitter the default tries span more than three minutes."""
    waits = [Patience().wait(tried, PASSING, jitter=0) for tried in range(1, Patience().tries)]
    assert math.fsum(wait for wait in waits if wait is not None) > 180


@pytest.mark.parametrize(
    ("words", "sent", "dropped"),
    [
        ("`temperature` is not supported with this model", {"temperature"}, "temperature"),
        ("`temperature` and `top_p` cannot both be given", {"temperature", "top_p"}, "top_p"),
        ("`temperature` and `top_p` cannot both be given", {"temperature"}, "temperature"),
        ("top_k: extra inputs are not permitted", {"temperature"}, None),
        ("temperatures rise", {"temperature"}, None),
        ("messages.0: this is not understood", set(SAMPLING), None),
    ],
)
def test_only_a_named_setting_that_was_sent_is_dropped(words: str, sent: set[str], dropped: str | None) -> None:
    """Of several named ones the last goes, so that no more is lost than is needed."""
    assert setting_to_drop(refusal(words), sent) == dropped


def test_overload_that_mentions_a_setting_drops_nothing() -> None:
    """Only a refusal speaks about settings."""
    assert setting_to_drop(refusal("busy with temperature", 529), {"temperature"}) is None
