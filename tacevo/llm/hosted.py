"""Asking a hosted model many things at once: concurrency, retries, refused settings; for any provider.

What it promises: an answer is stored the moment it arrives, in the loop that asked for it, and then yielded; neither a
failure nor an interruption loses another answer that is in flight; no message and no answer holds the key, even where a
server echoes it. What it does not: an answer that the server finished and could not deliver is asked for again.
"""

import asyncio
import logging
import queue
import random
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, Protocol

import httpx2

from tacevo.llm.failures import Failures, Models, Notices, scrubbed
from tacevo.llm.recording import Keep, unkept
from tacevo.llm.retry import Fault, FaultError, FaultKind, Patience
from tacevo.records import Completion, Request
from tacevo.redaction import without_secrets

_LOG = logging.getLogger(__name__)

#: Seconds between two looks at whether a waiting retry is still wanted.
_LOOK = 0.2

#: Answers written at once: a disk takes many synced files in little more time than one.
_WRITERS = 16


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


#: Positions and what came of them, from the asking thread to the reader; an error; None at the end.
_Arrivals = queue.SimpleQueue[tuple[int, Completion | Fault] | Exception | None]


class HostedLLM:
    """Answers requests by a server, up to `concurrency` at once.

    Args:
        connect: connects to the server; called for every round of requests.
        concurrency: requests in flight at once.
        name: what the user chose, for messages, e.g. `llm=anthropic`.
        patience: how failures are retried.
        models: what is known of the models before the first request.
    """

    def __init__(
        self,
        connect: Callable[[], Server],
        *,
        concurrency: int,
        name: str,
        patience: Patience | None = None,
        models: Models | None = None,
    ) -> None:
        self._connect = connect
        self._concurrency = concurrency
        self._name = name
        self._patience = patience or Patience()
        self._models = models or Models()
        self._notices = Notices(name)

    def complete(self, requests: Sequence[Request], keep: Keep = unkept) -> Iterator[tuple[int, Completion]]:
        """Answer every request, in the order of arrival (see `tacevo.llm.recording.KeepingLLM`).

        Raises:
            ConfigError: the server refuses the key, the model, a setting or the payment; asking again cannot help.
            TransportError: a request failed after all tries; what else was in flight was yielded before.
            StoreError: an answer could not be kept.
        """
        asking = _Asking(
            server=self._connect(), models=self._models, patience=self._patience, notices=self._notices, keep=keep
        )
        thread = threading.Thread(target=asking.run, args=(requests, self._concurrency), daemon=True)
        thread.start()
        failures = Failures(name=self._name, models=self._models)
        broken: Exception | None = None
        try:
            while (arrival := asking.arrivals.get()) is not None:
                if isinstance(arrival, Exception):
                    broken = broken or arrival
                elif isinstance(arrival[1], Fault):
                    failures.add(arrival[0], requests[arrival[0]], arrival[1])
                else:
                    yield arrival[0], arrival[1]
        except KeyboardInterrupt:
            _LOG.warning(
                "waiting for the answers in flight, because they are paid for; press Ctrl-C again to leave now"
            )
            raise
        finally:
            asking.over.set()
            thread.join()
        if broken is not None:
            raise broken
        for position, completion in failures.recorded():
            yield position, keep(requests[position], completion)
        failures.raise_rest(len(requests))


class _Asking:
    """The side of one round that asks: an event loop in a thread of its own.

    Args:
        server: where to ask.
        models: what the run knows of its models.
        patience: how failures are retried.
        notices: reports retries.
        keep: stores an answer.
    """

    def __init__(self, *, server: Server, models: Models, patience: Patience, notices: Notices, keep: Keep) -> None:
        self._server = server
        self._models = models
        self._patience = patience
        self._notices = notices
        self._keep = keep
        self._jitter = random.Random()
        self._lacks_a_model = False
        self.arrivals: _Arrivals = queue.SimpleQueue()
        #: Once set, no request and no retry begins; what is in flight still arrives and is kept.
        self.over = threading.Event()

    def run(self, requests: Sequence[Request], concurrency: int) -> None:
        """Ask until every request has its answer or its fault, or it is over."""
        try:
            asyncio.run(self._ask_all(requests, concurrency))
        except Exception as error:  # the reader must see every error
            self.arrivals.put(error)
        finally:
            self.arrivals.put(None)

    async def _ask_all(self, requests: Sequence[Request], concurrency: int) -> None:
        asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor(_WRITERS))
        waiting = iter(enumerate(requests))

        async def work() -> None:
            for position, request in waiting:  # shared: each request goes to the first place that is free
                if self.over.is_set():
                    return
                await self._answer(position, request)

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
            await self._server.close()

    async def _answer(self, position: int, request: Request) -> None:
        """Ask, and keep the answer before the reader sees it."""
        answer = await self._ask(request)
        if isinstance(answer, Fault):
            self._models.note_refusal(request)
            self._lacks_a_model = self._lacks_a_model or answer.kind is FaultKind.unknown
            if answer.hopeless:
                self.over.set()
            self.arrivals.put((position, answer))
            return
        try:
            self.arrivals.put((position, await asyncio.to_thread(self._keep, request, answer)))
        except Exception as error:  # the others in flight are still kept
            self.over.set()
            self.arrivals.put(error)

    async def _ask(self, request: Request) -> Completion | Fault:
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
            if wait is None:
                return fault
            self._notices.tell(fault, wait)
            if not await self._waited(wait):
                return fault

    async def _waited(self, seconds: float) -> bool:
        """Wait; return whether the run goes on."""
        end = time.monotonic() + seconds
        while not self.over.is_set() and (left := end - time.monotonic()) > 0:
            await asyncio.sleep(min(left, _LOOK))
        return not self.over.is_set()


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
