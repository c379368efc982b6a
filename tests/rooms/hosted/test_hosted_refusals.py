"""Promise: whatever a server refuses for good ends in the right blame: settings, account, model, or one request.

The real SDKs talk to a server in this process, over real connections; each rule holds for both.
"""

import contextlib
import threading
from dataclasses import replace
from pathlib import Path

import pytest
from asked import request
from hosted import PROVIDERS, hosted, texts
from llm_script import Script, text_of
from llm_server import serving
from refusals import refused

from tacevo.errors import ConfigError
from tacevo.llm.failures import Models
from tacevo.llm.prices import ListedPrice, PriceTable
from tacevo.llm.recording import RecordingLLM, ever_answered
from tacevo.storage.canonical import value_at
from tacevo.storage.store import Store

pytestmark = pytest.mark.usefixtures("keys")

both = pytest.mark.parametrize("provider", PROVIDERS)


@pytest.mark.few(4)
@both
@pytest.mark.parametrize(
    ("fault", "remedy"),
    [
        ("401", "check the API key"),
        ("403", "check the API key"),
        ("402", "check the account"),
        ("credit", "check the account"),
        ("404", "check llm.base_url"),
    ],
)
def test_refused_key_model_or_payment_stops_the_run(fault: str, remedy: str, provider: str) -> None:
    """What no retry can mend is the user's to mend, is reported at once, and is never recorded as an answer.

    Only a refused key is blamed on the key.
    """
    with serving() as server:
        llm = hosted(server.url, provider)
        assert texts(llm, "a") == ["a!"]
        with refused(ConfigError, got="the server says: ", remedy=remedy):
            texts(llm, f"b [fault {fault}]")
        assert sorted(server.tried.values()) == [1, 1]


@both
@pytest.mark.parametrize(
    ("fault", "stop_reason"), [("too_long", "invalid_request"), ("413", "invalid_request"), ("filtered", "refusal")]
)
def test_request_that_can_never_be_answered_stops_no_run(fault: str, stop_reason: str, provider: str) -> None:
    """A completion without text stands in for the answer, and the gate rejects it; the request is not retried."""
    with serving() as server:
        answers = dict(hosted(server.url, provider).complete([request(f"a [fault {fault}]"), request("b")]))
        assert (answers[0].text, answers[0].stop_reason, answers[0].output_tokens) == ("", stop_reason, 0)
        assert answers[1].text == "b!"
        assert sorted(server.tried.values()) == [1, 1]


@both
def test_settings_that_an_earlier_run_was_answered_with_are_not_at_fault(provider: str, tmp_path: Path) -> None:
    """A resumed run that lacks nothing but one odd request goes on; other settings prove nothing."""
    store = Store(tmp_path, "completions")
    odd = request("b [fault invalid]")
    with serving() as server:
        list(RecordingLLM(hosted(server.url, provider), store).complete([request("a")]))
        other = replace(odd, max_tokens=78)
        with refused(ConfigError, got="this is not understood"):
            list(resumed(server.url, provider, store).complete([other]))
        ((_, completion),) = resumed(server.url, provider, store).complete([odd])
        assert completion.stop_reason == "invalid_request"
        with refused(ConfigError, got="this is not understood"):
            list(resumed(server.url, provider, store).complete([other]))


def resumed(url: str, provider: str, store: Store) -> RecordingLLM:
    """Make what a new process makes over an old store."""
    models = Models(f"llm={provider}", lambda asked: ever_answered(store, asked))
    return RecordingLLM(hosted(url, provider, models=models), store)


@both
@pytest.mark.parametrize(
    ("asked", "reasons", "said"),
    [
        (["a", "b [fault invalid]", "c"], ["end_turn", "invalid_request", "end_turn"], None),
        (["a [fault invalid]", "b [fault invalid]", "c"], ["invalid_request", "invalid_request", "end_turn"], None),
        (["a", "b [fault invalid]", "c [fault invalid]"], ["end_turn"], "this is not understood"),
        (["a [fault invalid]", "b [fault invalid]"], [], "this is not understood"),
        (["a [fault too_long]", "b [fault too_long]"], [], "too long"),
    ],
)
def test_refusal_is_about_its_request_where_the_model_answers(
    asked: list[str], reasons: list[str], said: str | None, provider: str, tmp_path: Path
) -> None:
    """One odd request stops no run, nor do several before an answer; what all end with is recorded for none.

    Money or an account may have ended in words that nobody knows, or the settings are at fault: the store is not filled
    with refusals.
    """
    store = Store(tmp_path, "completions")
    with serving() as server:
        llm = RecordingLLM(hosted(server.url, provider, concurrency=1), store)
        with refused(ConfigError, got=said) if said else contextlib.nullcontext():
            list(llm.complete([request(text) for text in asked]))
    recorded = {
        value_at(one.request, ("messages", -1, "content")): value_at(one.answer, ("stop_reason",))
        for one in store.entries()
    }
    assert recorded == dict(zip(asked, reasons, strict=False))


@both
def test_answer_to_what_was_sent_before_a_refusal_proves_nothing(provider: str) -> None:
    """It was in flight when the money ended, and arrives last."""
    with serving() as server:
        server.held = {"a": threading.Event()}
        threading.Timer(0.3, server.held["a"].set).start()
        with refused(ConfigError, got="this is not understood"):
            texts(hosted(server.url, provider, concurrency=2), "a", "b [fault invalid]", "c [fault invalid]")


@both
def test_address_that_is_none_is_refused_before_anything_is_asked(provider: str) -> None:
    """The SDK's own words, with the setting that holds the address."""
    connect, _ = PROVIDERS[provider]
    with refused(ConfigError, place=f"llm={provider}", got="Invalid port", remedy="check llm.base_url"):
        connect("http://server:port", 1)


@both
def test_refused_settings_are_remembered(provider: str) -> None:
    """Once known, they are not even sent."""
    with serving(Script(refused=("temperature", "top_p"))) as server:
        llm = hosted(server.url, provider, concurrency=1)
        assert len(list(llm.complete([request(text, settings=(("top_p", 0.9),)) for text in "ab"]))) == 2
        assert [text_of(body) for body in server.bodies] == ["a", "a", "a", "b"]


#: What the models of a server take, and what is then sent and dropped of a temperature and a top_p.
TAKES = {
    "both": (Script(), {"temperature", "top_p"}),
    "one or the other": (Script(exclusive=("temperature", "top_p")), {"temperature"}),
    "no temperature": (Script(refused=("temperature",)), {"top_p"}),
    "neither": (Script(refused=("temperature", "top_p")), set()),
    "neither, and not together": (Script(refused=("temperature", "top_p"), exclusive=("temperature", "top_p")), set()),
}


@pytest.mark.few(4)
@both
@pytest.mark.parametrize("takes", TAKES)
def test_models_are_sent_the_settings_that_they_take(takes: str, provider: str) -> None:
    """As much as is taken, and the temperature rather than `top_p` where it is one of both; the rest is recorded."""
    script, sent = TAKES[takes]
    both_set = {"temperature", "top_p"}
    with serving(script) as server:
        asked = [request(text, settings=(("top_p", 0.9),)) for text in "abc"]
        answers = dict(hosted(server.url, provider).complete(asked))
        assert {completion.dropped for completion in answers.values()} == {tuple(sorted(both_set - sent))}
        assert all(both_set & body.keys() == sent for body in server.bodies[-1:])
        ((_, plain),) = hosted(server.url, provider).complete([request("d")])
        assert plain.dropped == (() if "temperature" in sent or takes.startswith("one") else ("temperature",))


LISTED = ListedPrice(input_usd=1.0, output_usd=5.0, dated="2026-11-21", source="a page")

#: A table with a model that is retired, one that is not, and one that costs nothing.
PRICES = PriceTable(
    models={
        "model-x": replace(LISTED, retired="2026-04-20"),
        "model-y": LISTED,
        "ours": replace(LISTED, input_usd=0.0, output_usd=0.0),
    },
    batch_factor=0.5,
)


@both
def test_model_that_the_server_lacks_is_reported_with_those_that_it_has(provider: str) -> None:
    """And with the day on which the model was retired."""
    with serving(Script(models=("model-y-20251001", "model-z"))) as server:
        llm = hosted(server.url, provider, models=Models(f"llm={provider}", prices=PRICES))
        expected = "a model that the server has (model-y-20251001, model-z)"
        with refused(ConfigError, place="llm.model", expected=expected, got="model-x, which was retired on 2026-04-20"):
            texts(llm, *"abcdefgh")


@both
@pytest.mark.parametrize(
    ("models", "expected"),
    [
        (Models("llm", prices=PRICES), "a model that llm.prices has (model-y)"),
        (Models("llm"), "a model that the server has"),
    ],
)
def test_server_without_a_list_of_models_is_no_further_fault(models: Models, expected: str, provider: str) -> None:
    """The message has what the price table knows, and what the server said."""
    with serving() as server, refused(ConfigError, expected=expected, got="the server says: 404"):
        texts(hosted(server.url, provider, models=models), "a [fault unknown]")
