"""Promise: requests are asked so many at once and retried; no fault or interruption loses another answer; no key leaks.

The real SDKs talk to a server in this process, over real connections; each rule holds for both.
"""

import asyncio
import itertools
import logging
import re
import threading
from pathlib import Path

import pytest
from asked import KEY, request
from hosted import PROVIDERS, QUICK, hosted, stored, texts
from llm_script import Script
from llm_server import serving
from refusals import refused
from waiting import eventually

from tacevo.errors import ConfigError, StoreError, TransportError
from tacevo.llm.failures import KEY_REPEATED, Models
from tacevo.llm.hosted import SHARE, HostedLLM
from tacevo.llm.recording import RecordingLLM
from tacevo.llm.retry import Fault, FaultError, FaultKind
from tacevo.records import Completion, Request
from tacevo.storage.store import Store

pytestmark = pytest.mark.usefixtures("keys")
both = pytest.mark.parametrize("provider", PROVIDERS)


@pytest.mark.few(6)
@both
@pytest.mark.parametrize(
    "fault", ["429", "429_bare", "408", "409", "500", "503", "529", "reset", "malformed", "shapeless"]
)
def test_passing_fault_is_retried_until_it_passes(fault: str, provider: str) -> None:
    """Whatever passes is asked again, and nothing of it is seen."""
    with serving() as server:
        assert texts(hosted(server.url, provider), f"a [fault {fault} x2]", "b") == [f"a [fault {fault} x2]!", "b!"]
        assert sorted(server.tried.values()) == [1, 3]
        assert sorted(server.billed.values()) == [1, 1]


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


@pytest.mark.few(1)
@both
def test_no_client_holds_a_request_back(provider: str) -> None:
    """Of requests for three clients, all are open together, and every one is answered."""
    many = 3 * SHARE
    with serving(Script(together=many)) as server:
        assert len(texts(hosted(server.url, provider, concurrency=many), *map(str, range(many)))) == many
        assert server.most == many


class _Fake:
    """A server without a list of models and without connections."""

    secrets: tuple[str, ...] = ()
    sampling: tuple[str, ...] = ()
    answer = Completion(text="", model="m", stop_reason="end_turn", input_tokens=1, output_tokens=0)

    async def models(self) -> tuple[str, ...]:
        return ()

    async def close(self) -> None:
        pass


class _Starting(_Fake):
    """A server that answers once all have begun, and notes how many had, whenever one of them got its first turn."""

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
        return self.answer


def test_requests_begin_one_after_the_other() -> None:
    """Each begins when those before it had a turn: a thousand that begin in one go would keep the first from one."""
    server = _Starting(together=50)
    llm = HostedLLM(lambda: server, concurrency=50, models=Models("llm=fake"))
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
        with refused(TransportError, got="1 of 3 requests failed", remedy="repeat the same command"):
            next(answers)


@both
def test_after_a_final_failure_nothing_further_begins(provider: str) -> None:
    """A refused key or a dead server is not asked a thousand times."""
    with serving() as server:
        with refused(ConfigError, got="401", remedy="check the API key"):
            texts(hosted(server.url, provider, concurrency=2), *(f"{n} [fault 401]" for n in range(100)))
        assert sum(server.tried.values()) < 50


@both
def test_wrong_path_in_the_address_is_told(provider: str) -> None:
    """A base_url with a part too much: the message shows the path that was asked for, and the setting to mend."""
    with serving() as server, refused(ConfigError) as caught:
        texts(hosted(f"{server.url}/api", provider), "a")
    assert re.search(r"404: .*/api/v1/.* was asked for: .*llm\.base_url", caught.value.got)


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
        assert (completion.text, completion.stop_reason, completion.output_tokens) == ("", KEY_REPEATED, 7)
        with refused(TransportError, got="no, ***") as caught:
            texts(hosted(server.url, provider, patience=QUICK), "b [fault 500]")
        with refused(ConfigError, got="no, ***") as denied:
            texts(hosted(server.url, provider), "c [fault 401]")
        assert server.logins == {KEY}
    for error in (caught.value, denied.value):
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
    assert [line.partition(", ***")[0] for line in said] == [f"llm={provider}: {status}: no" for status in (503, 529)]


@both
@pytest.mark.parametrize("spoilt", [f"{KEY}\n", f" {KEY}", f"{KEY}\x7f", f"{KEY}é"])
def test_key_that_cannot_be_sent_as_it_stands_is_refused(
    spoilt: str, provider: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a client makes of it could not be blacked out; the message says which variable, and not what is in it."""
    variable = f"{provider.upper()}_API_KEY"
    monkeypatch.setenv(variable, spoilt)
    with refused(ConfigError, place=variable, expected="an API key", got="a blank, a line break") as caught:
        texts(hosted("http://127.0.0.1:1", provider), "a")
    assert KEY not in str(caught.value)


class _Slow(_Fake):
    """A server that answers a request when it is let go."""

    def __init__(self) -> None:
        self.begun: list[str] = []
        self.go = threading.Semaphore(0)

    async def ask(self, request: Request, dropped: tuple[str, ...]) -> Completion:
        self.begun.append(request.messages[-1].content)
        if request.messages[-1].content == "retried":
            raise FaultError(Fault(kind=FaultKind.passing, message="429: later", retry_after=600))
        await asyncio.to_thread(self.go.acquire)
        return self.answer


def slow(*, concurrency: int = 1) -> tuple[_Slow, HostedLLM]:
    """Make such a server, and an LLM that asks it."""
    server = _Slow()
    return server, HostedLLM(lambda: server, concurrency=concurrency, models=Models("llm=fake"))


def test_answers_are_stored_before_the_reader_sees_them(tmp_path: Path) -> None:
    """A slow reader, or one that is killed, keeps no answer from the store."""
    server, llm = slow(concurrency=3)
    answers = RecordingLLM(llm, Store(tmp_path, "completions")).complete([request(text) for text in "abc"])
    server.go.release(3)
    next(answers)
    assert eventually(lambda: stored(tmp_path) == ["a", "b", "c"])


def test_reader_who_leaves_loses_no_answer(tmp_path: Path) -> None:
    """What is in flight is waited for and stored; no request and no retry begins."""
    server, llm = slow(concurrency=3)
    asked = [request(text) for text in ("a", "b", "retried", "c", "d")]
    answers = RecordingLLM(llm, Store(tmp_path, "completions")).complete(asked)
    server.go.release()
    next(answers)
    assert eventually(lambda: len(server.begun) == 4)
    threading.Timer(0.3, server.go.release, (2,)).start()
    answers.close()  # type: ignore[attr-defined]
    assert sorted(server.begun) == ["a", "b", "c", "retried"]
    assert stored(tmp_path) == ["a", "b", "c"]


class _Broken(_Slow):
    """Such a server, which fails for the request `a` in a way that it should not, after it was asked for `b`."""

    async def ask(self, request: Request, dropped: tuple[str, ...]) -> Completion:
        if request.messages[-1].content == "a":
            await asyncio.to_thread(eventually, lambda: self.begun == ["b"])
            raise RuntimeError("unforeseen")
        return await super().ask(request, dropped)


def test_unforeseen_failure_loses_no_answer_in_flight(tmp_path: Path) -> None:
    """An exception that no provider should raise ends the asking, after the others in flight are stored."""
    server = _Broken()
    llm = HostedLLM(lambda: server, concurrency=2, models=Models("llm=fake"))
    threading.Timer(0.3, server.go.release).start()
    with pytest.raises(RuntimeError, match="unforeseen"):
        list(RecordingLLM(llm, Store(tmp_path, "completions")).complete([request("a"), request("b")]))
    assert stored(tmp_path) == ["b"]


class _Unclosed(_Slow):
    """Such a server, whose connections cannot be closed."""

    async def close(self) -> None:
        raise RuntimeError("a connection stays open")


def test_failure_between_requests_reaches_the_reader(tmp_path: Path) -> None:
    """What fails in the thread that asks does not end in silence; the answers before are seen and stored."""
    server = _Unclosed()
    server.go.release()
    llm = HostedLLM(lambda: server, concurrency=1, models=Models("llm=fake"))
    answers = RecordingLLM(llm, Store(tmp_path, "completions")).complete([request("a")])
    assert next(answers)[0] == 0
    with pytest.raises(RuntimeError, match="stays open"):
        next(answers)
    assert stored(tmp_path) == ["a"]


def test_full_disk_stops_the_asking_and_nothing_else(tmp_path: Path) -> None:
    """An answer that cannot be stored is an error and ends the asking; others in flight are still stored."""
    server, llm = slow(concurrency=2)

    def keep(asked: Request, completion: Completion) -> Completion:
        if asked.messages[-1].content == "a":
            raise StoreError("full")
        return completion

    server.go.release(3)
    answers = llm.complete([request(text) for text in "abc"], keep)
    assert next(answers)[0] == 1
    with refused(StoreError, got="full"):
        list(answers)
    assert sorted(server.begun) in (["a", "b"], ["a", "b", "c"])  # the third may begin before the first failed
