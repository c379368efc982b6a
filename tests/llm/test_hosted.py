"""Promise: requests are asked so many at once and retried; no fault or interruption loses another answer; no key leaks.

The real SDKs talk to a server in this process, over real connections; each rule holds for both.
"""

import asyncio
import itertools
import logging
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from hosted import KEY, PROVIDERS, hosted, request
from llm_script import Script, text_of
from llm_server import LLMServer, serving

from tacevo.errors import ConfigError, LLMError, TransportError
from tacevo.llm.failures import Models
from tacevo.llm.hosted import HostedLLM
from tacevo.llm.prices import PriceTable
from tacevo.llm.recording import RecordingLLM, ever_answered
from tacevo.llm.retry import Patience
from tacevo.records import Completion, Price, Request
from tacevo.storage.store import Store

QUICK = Patience(tries=3, first=0.001, longest=0.01)

both = pytest.mark.parametrize("provider", PROVIDERS)


@pytest.fixture(autouse=True)
def _keys(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put keys where the SDKs look for them."""
    for name in ("ANTHROPIC_API_KEY", "OPENAI_API_KEY"):
        monkeypatch.setenv(name, KEY)


def texts(llm: HostedLLM, *asked: str) -> list[str]:
    """Ask, and give the answers in the order of the requests."""
    answers = dict(llm.complete([request(text) for text in asked]))
    return [answers[position].text for position in range(len(asked))]


@both
@pytest.mark.parametrize("fault", ["429", "429_bare", "408", "409", "500", "503", "529", "reset", "malformed"])
def test_passing_fault_is_retried_until_it_passes(fault: str, provider: str) -> None:
    """Whatever passes is asked again, and nothing of it is seen."""
    with serving() as server:
        assert texts(hosted(server.url, provider), f"a [fault {fault} x2]", "b") == [f"a [fault {fault} x2]!", "b!"]
        assert sorted(server.tried.values()) == [1, 3]
        assert sorted(server.billed.values()) == [1, 1]


@both
def test_body_of_another_shape_is_a_passing_fault(provider: str) -> None:
    """JSON that is no answer is as good as none."""
    with serving() as server:
        assert texts(hosted(server.url, provider), "a [fault shapeless x1]") == ["a [fault shapeless x1]!"]


@both
def test_answers_come_in_the_order_of_arrival(provider: str) -> None:
    """An answer is seen as soon as it is there, whatever was asked before it."""
    with serving() as server:
        server.held = {text: threading.Event() for text in "abc"}
        answers = hosted(server.url, provider).complete([request(text) for text in "abc"])
        for position, text in [(2, "c"), (0, "a"), (1, "b")]:
            server.held[text].set()
            assert next(answers)[0] == position


@both
def test_so_many_requests_are_open_at_once(provider: str) -> None:
    """Four are open where four may be, and never more."""
    with serving(Script(delay=0.05)) as server:
        assert len(texts(hosted(server.url, provider, concurrency=4), *(str(n) for n in range(20)))) == 20
        assert server.most == 4


class _Starting:
    """A server that answers once all have begun, and notes how many had, whenever one of them got its first turn."""

    secrets: tuple[str, ...] = ()
    sampling: tuple[str, ...] = ()

    def __init__(self, together: int) -> None:
        self._together = together
        self._all = asyncio.Event()
        self._begun = 0
        self.seen: list[int] = []

    async def ask(self, request: Request, dropped: tuple[str, ...]) -> Completion:
        self._begun += 1
        if self._begun == self._together:
            self._all.set()
        await asyncio.sleep(0)
        self.seen.append(self._begun)
        await self._all.wait()
        return Completion(text="", model="m", stop_reason="end_turn", input_tokens=1, output_tokens=0)

    async def models(self) -> tuple[str, ...]:
        return ()

    async def close(self) -> None:
        pass


def test_requests_begin_one_after_the_other() -> None:
    """Each begins when those before it had a turn: a thousand that begin in one go would keep the first from one."""
    server = _Starting(together=50)
    llm = HostedLLM(lambda: server, concurrency=50, name="llm=fake")
    assert len(list(llm.complete([request(str(number)) for number in range(50)]))) == 50
    assert server.seen == list(range(1, 51))


@both
def test_rounds_follow_each_other(provider: str) -> None:
    """Every generation of a search asks anew, and none stumbles over the connections of the one before."""
    with serving() as server:
        llm = hosted(server.url, provider)
        for _ in range(3):
            assert texts(llm, "a", "b") == ["a!", "b!"]
        assert list(llm.complete([])) == []


@both
def test_failure_comes_after_the_answers_in_flight(provider: str) -> None:
    """The answers to the other requests are yielded first, and the error says what failed and what to do."""
    with serving() as server:
        llm = hosted(server.url, provider, patience=QUICK)
        answers = llm.complete([request(text) for text in ("a", "x [fault 529]", "b")])
        assert sorted(position for position, _ in itertools.islice(answers, 2)) == [0, 2]
        with pytest.raises(TransportError, match=r"1 of 3 requests failed.*529.*give the same command again"):
            next(answers)


@both
def test_unreachable_server_is_a_transport_error(provider: str) -> None:
    """Where nobody listens, the error is ours, and says so."""
    with pytest.raises(TransportError, match=r"2 of 2 requests failed.*APIConnectionError"):
        texts(hosted("http://127.0.0.1:1", provider, patience=QUICK), "a", "b")


@both
def test_after_a_final_failure_nothing_further_begins(provider: str) -> None:
    """A refused key or a dead server is not asked a thousand times."""
    with serving() as server:
        with pytest.raises(ConfigError, match="refuses the key"):
            texts(hosted(server.url, provider, concurrency=2), *(f"{n} [fault 401]" for n in range(100)))
        assert sum(server.tried.values()) < 50


@both
def test_wrong_path_in_the_address_is_told(provider: str) -> None:
    """A base_url with a part too much: the message shows the path that was asked for, and the setting to mend."""
    with serving() as server, pytest.raises(ConfigError, match=r"404: .*/api/v1/.* was asked for: .*llm\.base_url"):
        texts(hosted(f"{server.url}/api", provider), "a")


@both
@pytest.mark.parametrize("fault", ["401", "402", "403", "404", "credit"])
def test_refused_key_model_or_payment_stops_the_run(fault: str, provider: str) -> None:
    """What no retry can mend is the user's to mend, is told at once, and is never recorded as an answer."""
    with serving() as server:
        llm = hosted(server.url, provider)
        assert texts(llm, "a") == ["a!"]
        with pytest.raises(ConfigError, match="the server refuses the key or a setting"):
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
def test_settings_with_which_no_request_is_answered_are_at_fault(provider: str) -> None:
    """A token limit that the model does not have would else be recorded as a generation of empty answers."""
    with serving() as server, pytest.raises(ConfigError, match=r"set llm\.max_tokens or llm\.model.*too long"):
        texts(hosted(server.url, provider), "a [fault too_long]", "b [fault too_long]")


@both
def test_settings_that_an_earlier_run_was_answered_with_are_not_at_fault(provider: str, tmp_path: Path) -> None:
    """A resumed run that lacks nothing but one odd request goes on; other settings prove nothing."""
    store = Store(tmp_path, "completions")
    odd = request("b [fault invalid]")
    with serving() as server:
        list(RecordingLLM(hosted(server.url, provider), store).complete([request("a")]))
        other = replace(odd, max_tokens=78)
        with pytest.raises(ConfigError, match="this is not understood"):
            list(resumed(server.url, provider, store).complete([other]))
        ((_, completion),) = resumed(server.url, provider, store).complete([odd])
        assert completion.stop_reason == "invalid_request"
        with pytest.raises(ConfigError, match="this is not understood"):
            list(resumed(server.url, provider, store).complete([other]))


def resumed(url: str, provider: str, store: Store) -> RecordingLLM:
    """Make what a new process makes over an old store."""
    models = Models(lambda asked: ever_answered(store, asked))
    return RecordingLLM(hosted(url, provider, models=models), store)


@both
def test_doubtful_refusal_is_about_the_request_where_others_are_answered(provider: str) -> None:
    """One odd request of three stops no run."""
    with serving() as server:
        asked = [request(text) for text in ("a", "b [fault invalid]", "c")]
        answers = dict(hosted(server.url, provider).complete(asked))
        assert [answers[position].stop_reason for position in range(3)] == ["end_turn", "invalid_request", "end_turn"]


@both
def test_doubtful_refusal_of_everything_is_about_the_settings(provider: str) -> None:
    """Where the model answers nothing at all, nothing is recorded: the configuration is at fault."""
    with serving() as server, pytest.raises(ConfigError, match="this is not understood"):
        texts(hosted(server.url, provider), "a [fault invalid]", "b [fault invalid]")


@both
def test_refusal_of_all_that_follows_an_answer_is_recorded_for_none(provider: str, tmp_path: Path) -> None:
    """Money or an account may have ended in words that nobody knows: the store is not filled with refusals."""
    store = Store(tmp_path, "completions")
    with serving() as server:
        llm = RecordingLLM(hosted(server.url, provider, concurrency=1), store)
        with pytest.raises(ConfigError, match="this is not understood"):
            list(llm.complete([request(text) for text in ("a", "b [fault invalid]", "c [fault invalid]")]))
        with pytest.raises(ConfigError, match="this is not understood"):
            list(llm.complete([request(text) for text in ("d [fault invalid]", "e [fault invalid]")]))
    assert [entry.request["messages"][-1]["content"] for entry in store.entries()] == ["a"]


@both
def test_same_refusals_are_about_the_requests_where_an_answer_follows(provider: str) -> None:
    """What was sent after the last of them was answered, so the account stands."""
    with serving() as server:
        asked = [request(text) for text in ("a [fault invalid]", "b [fault invalid]", "c")]
        answers = dict(hosted(server.url, provider, concurrency=1).complete(asked))
        assert [answers[number].stop_reason for number in range(3)] == [
            "invalid_request",
            "invalid_request",
            "end_turn",
        ]


@both
def test_answer_to_what_was_sent_before_a_refusal_proves_nothing(provider: str) -> None:
    """It was in flight when the money ended, and arrives last."""
    with serving() as server:
        server.held = {"a": threading.Event()}
        threading.Timer(0.3, server.held["a"].set).start()
        with pytest.raises(ConfigError, match="this is not understood"):
            texts(hosted(server.url, provider, concurrency=2), "a", "b [fault invalid]", "c [fault invalid]")


@both
def test_refused_settings_are_dropped_recorded_and_remembered(provider: str) -> None:
    """Each request is answered without what its model refuses; once known, it is not even sent."""
    with serving(Script(refused=("temperature", "top_p"))) as server:
        llm = hosted(server.url, provider, concurrency=1)
        asked = [request(text, settings=(("top_p", 0.9),)) for text in "ab"]
        assert {completion.dropped for _, completion in llm.complete(asked)} == {("temperature", "top_p")}
        ((_, plain),) = llm.complete([request("c")])
        assert plain.dropped == ("temperature",)
        assert [text_of(body) for body in server.bodies] == ["a", "a", "a", "b", "c"]


#: What the models of a server take, and what is then sent and dropped of a temperature and a top_p.
TAKES = {
    "both": (Script(), {"temperature", "top_p"}),
    "one or the other": (Script(exclusive=("temperature", "top_p")), {"temperature"}),
    "no temperature": (Script(refused=("temperature",)), {"top_p"}),
    "neither": (Script(refused=("temperature", "top_p")), set()),
    "neither, and not together": (Script(refused=("temperature", "top_p"), exclusive=("temperature", "top_p")), set()),
}


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


#: A table with a model that is retired, one that is not, and one that costs nothing.
PRICES = PriceTable(
    models={
        "model-x": Price(input_usd=1.0, output_usd=5.0, dated="2026-11-21"),
        "model-y": Price(input_usd=1.0, output_usd=5.0, dated="2026-11-21"),
        "ours": Price(input_usd=0.0, output_usd=0.0, dated="2026-11-21"),
    },
    batch_factor=0.5,
    retired={"model-x": "2026-04-20"},
)


@both
def test_model_that_the_server_lacks_is_told_with_the_names_to_use(provider: str) -> None:
    """Those that it lists, and those of the price table that are not retired; and when the model was retired."""
    words = (
        r"the server has no model model-x, which was retired on 2026-04-20; set llm\.model to one that it lists "
        r"\(model-y-20251001, model-z\) or that llm\.prices has \(model-y\)\. It says: 404: model: model-x"
    )
    with serving(Script(models=("model-y-20251001", "model-z"))) as server:
        llm = hosted(server.url, provider, models=Models(prices=PRICES))
        with pytest.raises(ConfigError, match=words) as caught:
            texts(llm, *"abcdefgh")
    assert "llm.base_url" not in str(caught.value)


@both
def test_server_without_a_list_of_models_is_no_further_fault(provider: str) -> None:
    """The message has what the price table knows, and without one what the server said."""
    for models, words in [
        (Models(prices=PRICES), r"set llm\.model to one that llm\.prices has \(model-y\)\. It says: 404"),
        (Models(), r"the server has no model model-x; set llm\.model to one that it has\. It says: 404"),
    ]:
        with serving() as server, pytest.raises(ConfigError, match=words):
            texts(hosted(server.url, provider, models=models), "a [fault unknown]")


@both
@pytest.mark.parametrize(
    ("fault", "stop_reason"), [("refusal", "refusal"), ("max_tokens", "max_tokens"), ("empty", "end_turn")]
)
def test_refusals_and_cut_off_answers_are_answers(fault: str, stop_reason: str, provider: str) -> None:
    """They are paid for, and a replay reproduces them."""
    with serving() as server:
        ((_, completion),) = hosted(server.url, provider).complete([request(f"a [fault {fault}]")])
        assert completion.stop_reason == stop_reason
        assert (completion.input_tokens, completion.output_tokens) == (11, 7)


@both
def test_model_is_recorded_as_returned(provider: str) -> None:
    """An alias stands for a dated name, and a server may serve another model: the record says which."""
    with serving() as server:
        answers = dict(hosted(server.url, provider).complete([request("a"), request("b [fault wrong_model]")]))
        assert [answers[0].model, answers[1].model] == ["model-x-dated", "another-model"]


@both
def test_key_is_seen_nowhere(provider: str, caplog: pytest.LogCaptureFixture) -> None:
    """Neither answers nor errors nor logs hold the key, even where the server says it."""
    with caplog.at_level(logging.DEBUG), serving() as server:
        ((_, completion),) = hosted(server.url, provider).complete([request("a [fault echo]")])
        assert completion.text == "you are ***"
        with pytest.raises(TransportError, match=r"no, \*\*\*") as caught:
            texts(hosted(server.url, provider, patience=QUICK), "b [fault 500]")
        with pytest.raises(ConfigError, match=r"no, \*\*\*") as refused:
            texts(hosted(server.url, provider), "c [fault 401]")
        assert server.logins == {KEY}
    for error in (caught.value, refused.value):
        assert error.__cause__ is None
        assert error.__context__ is None
    assert KEY not in caplog.text


@both
def test_user_hears_of_each_kind_of_retried_fault_once(provider: str, caplog: pytest.LogCaptureFixture) -> None:
    """A wrong address or an overloaded server is told of while there is still time to stop; the key is not."""
    with serving() as server:
        llm = hosted(server.url, provider)
        for number in (1, 2):
            texts(llm, f"a{number} [fault 529 x3]", f"b{number} [fault 503 x3]", "c")
    said = sorted(record.getMessage() for record in caplog.records if record.name.startswith("tacevo"))
    assert [line.partition("; asking again")[0] for line in said] == [
        f"llm={provider}: 503: no, *** (some_error)",
        f"llm={provider}: 529: no, *** (some_error)",
    ]


@both
@pytest.mark.parametrize("spoilt", [f"{KEY}\n", f" {KEY}", f"{KEY}\x7f", f"{KEY}é"])
def test_key_that_cannot_be_sent_as_it_stands_is_refused(
    spoilt: str, provider: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a client makes of it could not be blacked out; the message says which variable, and not what is in it."""
    variable = f"{provider.upper()}_API_KEY"
    monkeypatch.setenv(variable, spoilt)
    with pytest.raises(ConfigError, match=f"{variable} holds a blank, a line break") as caught:
        texts(hosted("http://127.0.0.1:1", provider), "a")
    assert KEY not in str(caught.value)


@both
def test_stopped_run_begins_nothing_further_and_ends_its_waits(provider: str) -> None:
    """What is in flight arrives; what waits for a retry gives up; what has not begun never does."""
    stop = threading.Event()
    with serving(Script(retry_after=600)) as server:
        server.held = {"a": threading.Event()}
        llm = hosted(server.url, provider, concurrency=2, stop=stop)
        answers = llm.complete([request(text) for text in ("a", "b [fault 429]", "c")])
        stops = threading.Thread(target=_stop_once_asked, args=(stop, server, 2))
        stops.start()
        assert next(answers)[1].text == "a!"
        with pytest.raises(LLMError, match="give the same command again"):
            next(answers)
        stops.join()
        assert {text_of(body) for body in server.bodies} == {"a", "b [fault 429]"}


def _stop_once_asked(stop: threading.Event, server: LLMServer, requests: int) -> None:
    """Stop a run once so many of its requests came, and only then let the server answer the one it holds."""
    while len(server.bodies) < requests:
        time.sleep(0.005)
    stop.set()
    server.held["a"].set()
