"""Promise: Claude is asked through the official SDK, so many requests at once; a failure loses no other answer.

The real SDK talks to a server in this process, over real connections.
"""

import itertools
import json
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import anthropic
import pytest

from tacevo.errors import ConfigError, TransportError
from tacevo.llm.anthropic import AnthropicLLM
from tacevo.records import Completion, Message, Request

KEY = "sk-ant-a-secret-key"


class Claude(ThreadingHTTPServer):
    """Holds what was asked, and lets answers wait for each other."""

    daemon_threads = True

    def __init__(self, meet: int = 1, pause: float = 0.0) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.bodies: list[dict[str, Any]] = []
        self.logins: set[str | None] = set()
        #: The most requests that were open at once.
        self.most = 0
        #: Answers that wait until the test lets them go, by their text.
        self.held: dict[str, threading.Event] = {}
        self._open = 0
        #: Holds answers back until so many requests are open.
        self._meeting = threading.Barrier(meet, timeout=30)
        #: Seconds before each answer, in which requests beyond the limit would show.
        self._pause = pause
        self._lock = threading.Lock()

    def take(self, body: dict[str, Any], login: str | None) -> None:
        """Note a request, and wait for the others."""
        with self._lock:
            self.bodies.append(body)
            self.logins.add(login)
            self._open += 1
            self.most = max(self.most, self._open)
        self._meeting.wait()

    def finish(self, text: str) -> None:
        """Wait until an answer may go, and note that it goes."""
        time.sleep(self._pause)
        if text in self.held:
            assert self.held[text].wait(timeout=30)
        with self._lock:
            self._open -= 1


class _Handler(BaseHTTPRequestHandler):
    """Speaks as much of the Messages API as the tests need."""

    protocol_version = "HTTP/1.1"
    server: Claude

    def do_POST(self) -> None:
        """Answer with the message itself; `status N` fails with that status."""
        body = json.loads(self.rfile.read(int(self.headers["content-length"])))
        text = body["messages"][-1]["content"]
        self.server.take(body, self.headers["authorization"])
        self.server.finish(text)
        status = int(text.removeprefix("status ")) if text.startswith("status ") else 200
        self._send(status, _message(text) if status == 200 else {"type": "error", "error": {"message": "no"}})

    def _send(self, status: int, content: dict[str, Any]) -> None:
        data = json.dumps(content).encode()
        self.send_response(status)
        self.send_header("content-type", "application/json")
        self.send_header("content-length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing."""


def _message(text: str) -> dict[str, Any]:
    return {
        "id": "msg_1",
        "type": "message",
        "role": "assistant",
        "model": "claude-dated",
        "content": [{"type": "text", "text": text}, {"type": "text", "text": "!"}],
        "stop_reason": "refusal" if text == "something bad" else "max_tokens",
        "stop_sequence": None,
        "usage": {"input_tokens": 11, "output_tokens": 7},
    }


def serving(server: Claude) -> Iterator[Claude]:
    """Serve until the test is over."""
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    yield server
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.fixture
def claude() -> Iterator[Claude]:
    """Give a server."""
    yield from serving(Claude())


@pytest.fixture
def claude_for_two() -> Iterator[Claude]:
    """Give a server that answers two requests at a time."""
    yield from serving(Claude(meet=2, pause=0.1))


def llm(server: Claude, *, concurrency: int = 4, max_retries: int = 0) -> AnthropicLLM:
    """Make the LLM that talks to a server."""

    def connect() -> anthropic.AsyncAnthropic:
        url = f"http://127.0.0.1:{server.server_port}"
        return anthropic.AsyncAnthropic(api_key=KEY, base_url=url, max_retries=max_retries)

    return AnthropicLLM(connect, concurrency=concurrency)


def request(text: str) -> Request:
    """Make a request."""
    turns = (Message(role="user", content="hello"), Message(role="assistant", content="hm"))
    messages = (*turns, Message(role="user", content=text))
    return Request(model="claude-x", system="Be brief.", messages=messages, temperature=0.65, max_tokens=77, draw=1)


def test_request_is_sent_whole(claude: Claude) -> None:
    """Model, system prompt, every turn, temperature and token limit reach the server; the draw number does not."""
    list(llm(claude).complete([request("hi")]))
    (body,) = claude.bodies
    turns = [("user", "hello"), ("assistant", "hm"), ("user", "hi")]
    assert body == {
        "model": "claude-x",
        "system": "Be brief.",
        "messages": [{"role": role, "content": content} for role, content in turns],
        "temperature": 0.65,
        "max_tokens": 77,
    }
    assert claude.logins == {f"Bearer {KEY}"}


@pytest.mark.parametrize(("text", "stop_reason"), [("hi", "max_tokens"), ("something bad", "refusal")])
def test_answer_is_recorded_whole(text: str, stop_reason: str, claude: Claude) -> None:
    """Text blocks are joined; the model as returned, the stop reason and the usage are kept; refusals are answers."""
    ((position, completion),) = llm(claude).complete([request(text)])
    assert position == 0
    assert completion == Completion(
        text=f"{text}!", model="claude-dated", stop_reason=stop_reason, input_tokens=11, output_tokens=7
    )


def test_answers_come_in_the_order_of_arrival(claude: Claude) -> None:
    """An answer is seen as soon as it is there, whatever was asked before it."""
    claude.held = {text: threading.Event() for text in "abc"}
    answers = llm(claude).complete([request(text) for text in "abc"])
    for position, text in [(2, "c"), (0, "a"), (1, "b")]:
        claude.held[text].set()
        assert next(answers)[0] == position


@pytest.mark.timeout(60)
def test_so_many_requests_are_open_at_once(claude_for_two: Claude) -> None:
    """Two at a time are needed for any answer here, and more than two are never open."""
    assert len(list(llm(claude_for_two, concurrency=2).complete([request(str(n)) for n in range(6)]))) == 6
    assert claude_for_two.most == 2


def test_batches_follow_each_other(claude: Claude) -> None:
    """Every generation of a search asks anew, and none stumbles over the connections of the one before."""
    asked = llm(claude, concurrency=2)
    for _ in range(3):
        assert len(list(asked.complete([request(str(n)) for n in range(4)]))) == 4


@pytest.mark.parametrize("status", [400, 429, 500, 529])
def test_failure_comes_after_the_other_answers(status: int, claude: Claude) -> None:
    """The answers to the other requests are yielded first, and the error says what failed and what to do."""
    answers = llm(claude).complete([request("a"), request(f"status {status}"), request("b")])
    assert sorted(position for position, _ in itertools.islice(answers, 2)) == [0, 2]
    expected = r"1 of 3 requests failed.*give the same command again: what came is recorded"
    with pytest.raises(TransportError, match=expected) as caught:
        next(answers)
    assert KEY not in f"{caught.value}{caught.value.__cause__!r}"


@pytest.mark.parametrize("status", [401, 403, 404])
def test_refused_key_or_model_is_the_users_to_mend(status: int, claude: Claude) -> None:
    """What no retry can mend is said at once, without the key."""
    with pytest.raises(ConfigError, match="the server refuses the key or the model") as caught:
        list(llm(claude).complete([request(f"status {status}")]))
    assert KEY not in f"{caught.value}{caught.value.__cause__!r}"


def test_overload_is_retried(claude: Claude) -> None:
    """The SDK asks again where the server is overloaded, so that nothing is recorded of it."""
    with pytest.raises(TransportError, match="1 of 1 requests failed"):
        list(llm(claude, max_retries=1).complete([request("status 529")]))
    assert len(claude.bodies) == 2


def test_unreachable_server_is_a_transport_error() -> None:
    """Where nobody listens, the error is ours, and holds no key."""

    def connect() -> anthropic.AsyncAnthropic:
        return anthropic.AsyncAnthropic(api_key=KEY, base_url="http://127.0.0.1:1", max_retries=0)

    with pytest.raises(TransportError, match=r"2 of 2 requests failed.*APIConnectionError") as caught:
        list(AnthropicLLM(connect, concurrency=1).complete([request("a"), request("b")]))
    assert KEY not in f"{caught.value}{caught.value.__cause__!r}"


def test_nothing_asked_is_nothing_answered(claude: Claude) -> None:
    """An empty batch sends nothing."""
    assert list(llm(claude).complete([])) == []
    assert claude.bodies == []
