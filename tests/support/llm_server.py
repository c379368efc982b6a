"""A real HTTP server on this machine that speaks the Messages, the Message Batches and the chat-completions API.

    with serving(Script(rate=0.3)) as server:      in a thread of this process
    python tests/support/llm_server.py --rate 0.3          in a process of its own; prints its address (see --help)

It misbehaves as its script says (tests/support/llm_script.py) and counts: an answer counts as billed when all of it was
handed to the connection, or when it stands in the results of a batch.
"""

import argparse
import asyncio
import contextlib
import json
import random
import socket
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from llm_models import MODELS
from llm_script import REFUSALS, Body, Script, chat, error, key_of, message, outcome_in_batch, text_of

#: What time a batch was made is of no interest here, but the API says it.
_TIMES = {"created_at": "2026-01-01T00:00:00Z", "expires_at": "2026-01-02T00:00:00Z"}


#: Connections that may wait to be accepted.
_BACKLOG = 16_384

#: Stop reasons of recorded answers that are served as they were recorded.
_SERVED = ("end_turn", "max_tokens")


@dataclass
class Batch:
    """One Message Batch."""

    id: str
    requests: list[Body]
    login: str
    #: How often it was looked at.
    polls: int = 0
    #: The results, once it has ended, one JSON a line.
    lines: list[str] = field(default_factory=list)
    #: When its results were deleted.
    archived_at: str | None = None


@dataclass
class Call:
    """One HTTP request."""

    method: str
    path: str
    login: str
    body: Body


class LLMServer:
    """The server and its counts; it runs in an event loop of its own thread."""

    def __init__(self, script: Script, listening: socket.socket) -> None:
        self.script = script
        self._listening = listening
        self.url = f"http://127.0.0.1:{listening.getsockname()[1]}"
        #: How often every request was tried and billed, by `key_of` its body.
        self.tried: Counter[str] = Counter()
        self.billed: Counter[str] = Counter()
        #: Every body of a single request, in the order of arrival, and what was logged in with.
        self.bodies: list[Body] = []
        self.logins: set[str] = set()
        #: The models that the Models API was asked about, in the order of arrival.
        self.asked_about: list[str] = []
        #: Requests that are open, and the most that were at once.
        self.open = 0
        self.most = 0
        self.batches: list[Batch] = []
        #: How often a batch's results were sent whole.
        self.results_read = 0
        #: Set where the script stalls.
        self.stalled = threading.Event()
        #: Answers that wait until the test sets their event, by the text of the request.
        self.held: dict[str, threading.Event] = {}
        self._stalls, self._cuts = {script.stall} - {""}, {script.cut} - {""}
        self._batch_faults = script.batch_faults
        self._gathered = asyncio.Event()

    async def serve(self, ended: asyncio.Event) -> None:
        """Answer until it is ended."""
        answering = await asyncio.start_server(self._talk, sock=self._listening, backlog=_BACKLOG, limit=2**24)
        await ended.wait()
        answering.close()

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer one connection's requests, one after the other."""
        with contextlib.suppress(ConnectionError, asyncio.IncompleteReadError, asyncio.CancelledError):
            while True:
                call = await _read(reader)
                await self._answer(call, writer)
        writer.transport.abort()

    async def _answer(self, call: Call, writer: asyncio.StreamWriter) -> None:
        self.logins.add(call.login)
        match call.method, call.path.partition("?")[0].strip("/").split("/"):
            case "POST", ["v1", "messages"] | ["v1", "chat", "completions"]:
                self.open += 1
                self.most = max(self.most, self.open)
                try:
                    await self._answer_one(call, writer)
                finally:
                    self.open -= 1
            case _, ["v1", "messages", "batches", *rest] if len(rest) <= 2:
                await self._answer_batches(call, [*rest, "", ""], writer)
            case "GET", ["v1", "models"] if self.script.models or self.script.like:
                await _send(writer, 200, _models((*self.script.models, *self.script.like)))
            case "GET", ["v1", "models", name]:
                self.asked_about.append(unquote(name))
                await self._tell(unquote(name), writer)
            case "GET", ["counts"]:
                await _send(writer, 200, {"tried": self.tried, "billed": self.billed, "most": self.most})
            case _:
                await _send(writer, 404, error("not_found_error", "Not Found"))

    async def _tell(self, name: str, writer: asyncio.StreamWriter) -> None:
        """Say what a model takes, as the Models API does, or misbehave."""
        if self.script.told is not None:
            await _send_text(writer, self.script.told[1], status=self.script.told[0])
        elif name in self.script.like:
            await _send(writer, 200, self.script.like[name].told(name))
        else:
            await _send(writer, 404, error("not_found_error", f"model: {name}"))

    async def _answer_one(self, call: Call, writer: asyncio.StreamWriter) -> None:
        """Answer one request of the Messages or the chat-completions API, or misbehave."""
        body, key = call.body, key_of(call.body)
        self.bodies.append(body)
        self.tried[key] += 1
        fault = self.script.fault(body, self.tried[key])
        if self.most >= self.script.together:
            self._gathered.set()
        await self._gathered.wait()
        await asyncio.sleep(self.script.delay + (self.script.slow if fault == "slow" else 0.0))
        while (held := self.held.get(text_of(body))) is not None and not held.is_set():
            await asyncio.sleep(0.005)
        refusal = self.script.refusal(body) or REFUSALS.get(fault)
        if self.script.lacks(body, fault):
            await _send(writer, 404, error("not_found_error", f"model: {body['model']}"))
        elif refusal:
            await _send(writer, 400, error("invalid_request_error", refusal))
        elif fault[:3].isdigit():
            headers = {"retry-after": str(self.script.retry_after)} if fault == "429" else {}
            await _send(writer, int(fault[:3]), error("some_error", f"no, {call.login}"), headers)
        else:
            text = self.script.text(body, fault, call.login)
            is_chat = call.path.endswith("/chat/completions")
            answer = chat(body, text, fault) if is_chat else message(body, text, fault, self.script.thoughts(body))
            await self._send_answer(writer, key, answer, fault)

    async def _send_answer(self, writer: asyncio.StreamWriter, key: str, answer: Body, fault: str) -> None:
        if fault == "reset":
            data = _response(200, json.dumps(answer))
            writer.write(data[: len(data) - 40])
            await writer.drain()
            raise ConnectionResetError
        if fault == "malformed":
            await _send_text(writer, json.dumps(answer)[:-25])
        elif fault == "shapeless":
            await _send(writer, 200, {"answer": answer})
        else:
            await _send(writer, 200, answer)
            self.billed[key] += 1

    async def _answer_batches(self, call: Call, rest: list[str], writer: asyncio.StreamWriter) -> None:
        """Speak the Message Batches API; `rest` is a batch's id and what is done with it, either may be empty."""
        if self._batch_faults > 0:
            self._batch_faults -= 1
            await _send(writer, self.script.batch_status, error("some_error", f"not now, {call.login}"))
            return
        name, act = rest[:2]
        if call.method == "POST" and not name:
            await self._stall("submitted")
            batch = Batch(id=f"msgbatch_{len(self.batches):04d}", requests=call.body["requests"], login=call.login)
            self.batches.append(batch)
            await self._stall("created")
            await _send(writer, 200, self._shown(batch))
            return
        batch = next((batch for batch in self.batches if batch.id == name), Batch(id="", requests=[], login=""))
        if not batch.id:
            await _send(writer, 404, error("not_found_error", f"no batch {name}"))
        elif act == "results":
            await self._send_results(batch, writer)
        else:
            self._advance(batch)
            await self._stall("polled")
            await _send(writer, 200, self._shown(batch))

    async def _send_results(self, batch: Batch, writer: asyncio.StreamWriter) -> None:
        if "results" in self._stalls | self._cuts:
            data = _response(200, "\n".join(batch.lines) + "\n")
            writer.write(data[: 2 * len(data) // 3])
            await writer.drain()
            await self._stall("results")
        self.results_read += 1
        await _send_text(writer, "\n".join(self._spoilt(batch.lines)) + "\n")

    def _spoilt(self, lines: list[str]) -> list[str]:
        """Spoil the last of a batch's results as the script says."""
        if self.script.results == "textless":
            last = json.loads(lines[-1])
            del last["result"]["message"]["content"]
            return [*lines[:-1], json.dumps(last)]
        return lines[:-1] if self.script.results == "lacking" else lines

    def _advance(self, batch: Batch) -> None:
        """Look at a batch once more; with the last look it ends, its results in any order."""
        batch.polls += 1
        if batch.lines or batch.polls <= self.script.polls:
            return
        for request in batch.requests:
            key = key_of(request["params"])
            self.tried[key] += 1
            result = outcome_in_batch(self.script, request["params"], batch.login)
            self.billed[key] += result["type"] == "succeeded"
            batch.lines.append(json.dumps({"custom_id": request["custom_id"], "result": result}))
        random.Random(self.script.seed).shuffle(batch.lines)

    def _shown(self, batch: Batch) -> Body:
        """Show a batch; like the real API, without the names of its requests."""
        outcomes = Counter(json.loads(line)["result"]["type"] for line in batch.lines)
        return {
            "id": batch.id,
            "type": "message_batch",
            "processing_status": "ended" if batch.lines else "in_progress",
            "request_counts": {
                "processing": 0 if batch.lines else len(batch.requests),
                **{kind: outcomes[kind] for kind in ("succeeded", "errored", "canceled", "expired")},
            },
            "results_url": f"{self.url}/v1/messages/batches/{batch.id}/results" if batch.lines else None,
            "ended_at": None,
            "cancel_initiated_at": None,
            "archived_at": batch.archived_at,
            **_TIMES,
        }

    async def _stall(self, where: str) -> None:
        """Stop here for good, or cut the connection, the first time."""
        if where in self._cuts:
            self._cuts.discard(where)
            raise ConnectionResetError
        if where in self._stalls:
            self._stalls.discard(where)
            self.stalled.set()
            await asyncio.sleep(3600)


def _models(names: tuple[str, ...]) -> Body:
    """List models, in a shape that both kinds of API share."""
    models = [
        {"id": name, "type": "model", "display_name": name, "created_at": "2026-01-01T00:00:00Z", "created": 0}
        for name in names
    ]
    return {"object": "list", "data": models, "has_more": False, "first_id": names[0], "last_id": names[-1]}


async def _read(reader: asyncio.StreamReader) -> Call:
    head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").split("\r\n")
    method, path, _ = head[0].split(" ")
    pairs = (line.split(":", 1) for line in head[1:] if line)
    headers = {name.lower(): value.strip() for name, value in pairs}
    data = await reader.readexactly(int(headers.get("content-length", 0)))
    login = headers.get("x-api-key") or headers.get("authorization", "").removeprefix("Bearer ")
    return Call(method=method, path=path, login=login, body=json.loads(data) if data else {})


def _response(status: int, text: str, headers: dict[str, str] | None = None) -> bytes:
    data = text.encode()
    lines = {"content-type": "application/json", "content-length": str(len(data)), **(headers or {})}
    head = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
    return f"HTTP/1.1 {status} Whatever\r\n{head}\r\n".encode() + data


async def _send(writer: asyncio.StreamWriter, status: int, body: Any, headers: dict[str, str] | None = None) -> None:
    writer.write(_response(status, json.dumps(body), headers))
    await writer.drain()


async def _send_text(writer: asyncio.StreamWriter, text: str, status: int = 200) -> None:
    writer.write(_response(status, text))
    await writer.drain()


def listen(port: int = 0) -> socket.socket:
    """Take a port of this machine, or any that is free; who connects waits until a server answers.

    Raises:
        OSError: it is in use, or not for this user.
    """
    return socket.create_server(("127.0.0.1", port), backlog=_BACKLOG)


@contextlib.contextmanager
def serving(script: Script | None = None, *, listening: socket.socket | None = None) -> Iterator[LLMServer]:
    """Run a server in a thread of this process, at a port that was taken or at any that is free."""
    server = LLMServer(script or Script(), listening or listen())
    loop, ended = asyncio.new_event_loop(), asyncio.Event()

    def run() -> None:
        loop.run_until_complete(server.serve(ended))
        for task in asyncio.all_tasks(loop):
            task.cancel()
        loop.run_until_complete(asyncio.sleep(0.01))
        loop.close()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        loop.call_soon_threadsafe(ended.set)
        thread.join()


def recorded_answers(folder: Path, task: str) -> Script:
    """Write a script that serves the answers which a model once gave to a task.

    A request that names a file (`force_000`) gets its answer, and every other one that which follows from its hash.

    Args:
        folder: of JSON files `<task>_<number>.json`, each with a `response` and its `stop_reason`, which is `end_turn`
            or `max_tokens`: other answers cannot be served as they were.
        task: whose answers; empty for those of every task.

    Raises:
        ValueError: the directory holds none, or one that ended otherwise.
    """
    paths = sorted(folder.glob(f"{task or '*'}_*.json"))
    if not paths:
        raise ValueError(f"{folder} holds no recorded answers {task or '*'}_*.json")
    recorded = {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in paths}
    for path in paths:
        if (reason := recorded[path.stem]["stop_reason"]) not in _SERVED:
            raise ValueError(f"{path} ended by {reason}; {' and '.join(_SERVED)} can be served: leave it out")

    def chosen(body: Body) -> Body:
        other = paths[int(key_of(body), 16) % len(paths)].stem
        return dict(recorded[text_of(body) if text_of(body) in recorded else other])

    def kind(body: Body) -> str:
        reason = str(chosen(body)["stop_reason"])
        return "" if reason == "end_turn" else reason

    return Script(answer=lambda body: str(chosen(body)["response"]), kind=kind)


def main(arguments: list[str] | None = None) -> int:
    """Serve until Ctrl-C; the address is the first line of the output."""
    parser = argparse.ArgumentParser(
        prog="python tests/support/llm_server.py",
        description="A local server that speaks the Messages, Message Batches and chat-completions APIs, for trying a "
        "provider without a bill: llm=anthropic llm.base_url=ADDRESS, or llm=openai llm.base_url=ADDRESS/v1. Any key "
        "will do. Its first line is its address; Ctrl-C ends it.",
    )
    parser.add_argument("--answers", type=Path, help="directory of recorded <task>_<number>.json; else it echoes")
    parser.add_argument("--task", default="force", help="whose recorded answers to serve (default: force)")
    parser.add_argument("--port", type=int, default=0, help="where to listen on 127.0.0.1 (default: any free port)")
    parser.add_argument("--like", choices=sorted(MODELS), help="take the part of that model, and of no other")
    parser.add_argument("--rate", type=float, default=0.0, help="part of the tries that fail, in [0, 1) (default: 0)")
    parser.add_argument("--seed", type=int, default=0, help="from which the failures follow (default: 0)")
    parser.add_argument("--delay", type=float, default=0.0, help="seconds before every answer (default: 0)")
    parser.add_argument("--together", type=int, default=0, help="answer nothing before so many requests are open")
    given = parser.parse_args(arguments)
    try:
        script = Script() if given.answers is None else recorded_answers(given.answers, given.task)
    except ValueError as unusable:
        parser.error(str(unusable))
    try:
        listening = listen(given.port)
    except OSError as taken:
        parser.error(f"cannot listen: {taken.strerror}; choose another --port")
    like = {} if given.like is None else {given.like: MODELS[given.like]}
    script = replace(script, like=like, rate=given.rate, seed=given.seed, delay=given.delay, together=given.together)
    with contextlib.suppress(KeyboardInterrupt), serving(script, listening=listening) as server:
        print(server.url, flush=True)
        threading.Event().wait()
    return 0


if __name__ == "__main__":
    sys.exit(main())
