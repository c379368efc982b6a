"""Asking a hosted model many things at once: concurrency, retries, refused settings; for any provider.

What it promises: an answer is handed on the moment it arrives; neither a failure nor an interruption loses another
answer that is in flight; no message and no answer holds the key, even where a server echoes it. What it does not: an
answer that the server finished and could not deliver is asked for again.
"""

import asyncio
import queue
import random
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Protocol

import httpx2

from tacevo.llm.failures import Failures, Models, Notices, scrubbed
from tacevo.llm.retry import Fault, FaultError, FaultKind, Patience
from tacevo.records import Completion, Request
from tacevo.redaction import without_secrets

#: Seconds between two looks at whether a waiting retry is still wanted.
_LOOK = 0.1


class Server(Protocol):
    """One provider's SDK, connected; its connections belong to the event loop that uses them."""

    #: What may appear in no message and no answer: the key.
    secrets: tuple[str, ...]
    #: Sampling settings that every request is sent with, beside those that it names itself.
    sampling: tuple[str, ...]

    async def ask(self, request: Request, dropped: tuple[str, ...]) -> Completion:
        """Try a request once, without the settings named in `dropped`.

        Raises:
            FaultError: there is no answer.
        """
        ...

    async def models(self) -> tuple[str, ...]:
        """Return the names of the models that the server lists; none where it gives no list."""
        ...

    async def close(self) -> None:
        """Close the connections."""
        ...


#: Positions and what came of them, from the asking thread to whoever reads; a bug; or None at the end.
_Arrivals = queue.SimpleQueue[tuple[int, Completion | Fault] | Exception | None]


class HostedLLM:
    """Answers requests by a server, up to `concurrency` at once.

    Args:
        connect: connects to the server; called for every round of requests.
        concurrency: requests in flight at once.
        name: what the user chose, for messages, e.g. `llm=anthropic`.
        patience: how failures are retried.
        models: what is known of the models before the first request.
        stop: once set, no request and no retry begins; what is in flight still arrives.
    """

    def __init__(
        self,
        connect: Callable[[], Server],
        *,
        concurrency: int,
        name: str,
        patience: Patience | None = None,
        models: Models | None = None,
        stop: threading.Event | None = None,
    ) -> None:
        self._connect = connect
        self._concurrency = concurrency
        self._name = name
        self._patience = patience or Patience()
        self._stop = stop or threading.Event()
        self._models = models or Models()
        self._notices = Notices(name)

    def complete(self, requests: Sequence[Request]) -> Iterator[tuple[int, Completion]]:
        """Answer every request, in the order of arrival (see `tacevo.search.effects.LLM`).

        Raises:
            ConfigError: the server refuses the key, the model, a setting or the payment; asking again cannot help.
            TransportError: a request failed after all tries; what else was in flight was yielded before.
            LLMError: the run was interrupted.
        """
        arrivals: _Arrivals = queue.SimpleQueue()
        failures = Failures(name=self._name, models=self._models)
        left = threading.Event()
        asking = _Asking(
            server=self._connect(),
            models=self._models,
            patience=self._patience,
            notices=self._notices,
            over=lambda: left.is_set() or self._stop.is_set() or failures.hopeless,
        )
        threading.Thread(target=asking.run, args=(requests, arrivals, self._concurrency), daemon=True).start()
        arrived = 0
        try:
            while (arrival := arrivals.get()) is not None:
                if isinstance(arrival, Exception):
                    raise arrival
                arrived += 1
                position, answer = arrival
                if isinstance(answer, Fault):
                    failures.add(position, requests[position], answer)
                else:
                    yield position, answer
            yield from failures.recorded()
        finally:
            left.set()  # nobody reads any more, so nothing further may begin
        failures.raise_rest(len(requests), interrupted=arrived < len(requests))


class _Asking:
    """The side of one round that asks: an event loop in a thread of its own.

    Args:
        server: where to ask.
        models: what the run knows of its models.
        patience: how failures are retried.
        notices: told of retries.
        over: says that nothing further may begin.
    """

    def __init__(
        self, *, server: Server, models: Models, patience: Patience, notices: Notices, over: Callable[[], bool]
    ) -> None:
        self._server = server
        self._models = models
        self._patience = patience
        self._notices = notices
        self._over = over
        self._jitter = random.Random()
        self._ended = asyncio.Event()
        #: Whether the server lacks a model that was asked.
        self._lacks_a_model = False

    def run(self, requests: Sequence[Request], arrivals: _Arrivals, concurrency: int) -> None:
        """Ask until every request has its answer or its fault, or it is over; then say that this is the end."""
        try:
            asyncio.run(self._ask_all(requests, arrivals, concurrency))
        except Exception as error:  # whatever it is, whoever waits must hear of it
            arrivals.put(error)
        finally:
            arrivals.put(None)

    async def _ask_all(self, requests: Sequence[Request], arrivals: _Arrivals, concurrency: int) -> None:
        waiting = iter(enumerate(requests))

        async def work() -> None:
            for position, request in waiting:  # shared: each request goes to the first place that is free
                if self._over():
                    return
                arrivals.put((position, await self._answer(request)))

        watching = asyncio.create_task(self._watch())
        try:
            places = []
            for _ in range(min(concurrency, len(requests))):
                places.append(asyncio.create_task(work()))
                # Thousands that begin in one go outlast the time in which the first must connect.
                await asyncio.sleep(0)
            await asyncio.gather(*places)
            if self._lacks_a_model:
                named = await self._server.models()
                self._models.served = tuple(without_secrets(name, self._server.secrets) for name in named)
        finally:
            watching.cancel()
            await self._server.close()

    async def _answer(self, request: Request) -> Completion | Fault:
        """Try until there is an answer, or no use in trying."""
        secrets, tried = self._server.secrets, 0
        wanted = {*self._server.sampling, *dict(request.settings)}
        while True:
            dropped = tuple(name for name in self._models.dropped(request) if name in wanted)
            tried += 1
            begun = self._models.now()
            try:
                completion = await self._server.ask(request, dropped)
            except FaultError as error:
                fault = replace(error.fault, message=without_secrets(error.fault.message, secrets))
            else:
                self._models.note_answer(request, begun)
                return scrubbed(replace(completion, dropped=dropped), secrets)
            if self._models.learn(request, wanted - {*dropped}, fault):
                continue
            wait = self._patience.wait(tried, fault, jitter=self._jitter.random())
            if wait is not None:
                self._notices.tell(fault, wait)
            if wait is None or not await self._waited(wait):
                self._models.note_refusal(request)
                self._lacks_a_model = self._lacks_a_model or fault.kind is FaultKind.unknown
                return fault

    async def _waited(self, seconds: float) -> bool:
        """Wait, and say whether the wait came to its end; once it is over, no wait does."""
        try:
            await asyncio.wait_for(self._ended.wait(), seconds)
        except TimeoutError:
            return not self._over()
        return False

    async def _watch(self) -> None:
        """Wake whoever waits once it is over."""
        while not self._over():
            await asyncio.sleep(_LOOK)
        self._ended.set()


#: Seconds for the list of models: without it, a message is only less helpful.
LISTING = 15.0


async def listed_models(client: Any, failures: tuple[type[Exception], ...]) -> tuple[str, ...]:
    """Return the names of the models that a server lists; none where it gives no list.

    Args:
        client: of the SDK of a provider; all have the same call.
        failures: what the SDK raises, or lets through, where there is no usable answer.
    """
    unusable: tuple[type[Exception], ...] = (*failures, AttributeError, TypeError)  # as of servers without that path
    try:
        page = await client.models.list(timeout=LISTING)
        return tuple(str(model.id) for model in page.data)
    except unusable:
        return ()


#: Requests of one client at once, about.
SHARE = 100


def shares(concurrency: int, timeout: httpx2.Timeout) -> Iterator[dict[str, Any]]:
    """Give the arguments of as many HTTP clients as so many requests at once need.

    Args:
        concurrency: requests at once; whoever asks keeps to it, so that no client has to hold any back.
        timeout: of every request.
    """
    context = httpx2.create_ssl_context()  # one for all: it holds every certificate authority
    limits = httpx2.Limits(max_connections=None, max_keepalive_connections=min(concurrency, 2 * SHARE))
    for _ in range(-(-concurrency // SHARE)):
        yield {"limits": limits, "timeout": timeout, "verify": context}
