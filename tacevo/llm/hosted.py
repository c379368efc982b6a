"""Asking a hosted model many things at once: concurrency, retries, refused settings; for any provider.

What it promises: an answer is stored the moment it arrives, in the loop that asked for it, and then yielded; neither a
failure nor an interruption loses another answer that is in flight, and nothing is waited for that was never sent; no
message and no recorded answer holds the key, even where a server echoes it. What it does not: an answer that the server
finished and could not deliver is asked for again.
"""

import asyncio
import contextlib
import itertools
import logging
import queue
import random
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

import httpx2

from tacevo.llm.capabilities import Catalogue
from tacevo.llm.failures import Failures, Models, settings_of
from tacevo.llm.recording import ever_answered, unkept
from tacevo.llm.retry import Fault, FaultError, FaultKind, Patience
from tacevo.llm.wire import HOOKS, SENDING, Sending, certificates, check_proxies
from tacevo.parts.making import Given
from tacevo.parts.provider import Keep
from tacevo.records import Completion, Request
from tacevo.redaction import without_secrets
from tacevo.storage.store import Store

_LOG = logging.getLogger(__name__)

#: A request as an SDK takes it; the types of the SDKs list every setting by its literal name.
Body = Any

#: Seconds between two looks at whether a waiting retry is still wanted.
_LOOK = 0.2

#: Answers written at once: a disk takes many synced files in little more time than one.
_WRITERS = 16


class Server(Protocol):
    """One provider's SDK, connected; its connections belong to the event loop that uses them."""

    #: The texts that may appear in no message and no answer: the key.
    secrets: tuple[str, ...]
    #: Sampling settings that every request is sent with, beside those that it names itself.
    sampling: tuple[str, ...]

    async def ask(self, request: Request, dropped: tuple[str, ...]) -> Completion:
        """Try a request once, without the settings named in `dropped`.

        Raises:
            FaultError: the server gave no answer.
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


def asking(
    given: Given, connect: Callable[[str | None, int], Server], catalogue: Catalogue | None = None
) -> "HostedLLM":
    """Make what asks a server by the settings of `llm`; a missing key is an error at once.

    Raises:
        ConfigError: the environment holds no key, or the address is not a URL.
    """
    llm = given.settings
    connect(llm["base_url"], 1)
    connected = partial(connect, llm["base_url"], llm["concurrency"])
    return HostedLLM(connected, concurrency=llm["concurrency"], models=models_of(given, catalogue))


def models_of(given: Given, catalogue: Catalogue | None = None) -> Models:
    """Return what is known of the models that the settings of `llm` ask, before the first request."""
    llm, store = given.settings, completions(given.root)
    unlabelled = None if llm["label"] is None else llm["model"]
    return Models(
        f"llm={llm['provider']}",
        partial(ever_answered, store),
        prices=given.prices,
        unlabelled=unlabelled,
        catalogue=catalogue,
    )


def completions(root: Path) -> Store:
    """Return the store of answers."""
    return Store(root, "completions")


@dataclass(slots=True)
class HostedLLM:
    """Answers requests by a server, up to `concurrency` at once."""

    #: Connects to the server; called for every round of requests.
    connect: Callable[[], Server]
    _: KW_ONLY
    #: Requests in flight at once.
    concurrency: int
    #: The facts that are known of the models before the first request.
    models: Models
    patience: Patience = field(default_factory=Patience)

    def complete(self, requests: Sequence[Request], keep: Keep = unkept) -> Iterator[tuple[int, Completion]]:
        """Answer every request, in the order of arrival (see `tacevo.parts.provider.Provider`).

        Raises:
            ConfigError: the server refuses the key, the model, a setting or the payment; asking again cannot help.
            TransportError: a request failed after all tries; what else was in flight was yielded before.
            StoreError: an answer could not be kept.
        """
        asking = _Asking(server=self.connect(), models=self.models, patience=self.patience, keep=keep)
        thread = threading.Thread(target=asking.run, args=(requests, self.concurrency), daemon=True)
        thread.start()
        failures = Failures(models=self.models)
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
            asking.leave()
            raise
        finally:
            asking.over.set()
            thread.join()
        if broken is not None:
            raise broken
        for position, completion in failures.recorded():
            yield position, keep(requests[position], completion)
        failures.raise_rest(len(requests))


@dataclass(slots=True, kw_only=True)
class _Asking:
    """The side of one round that asks: an event loop in a thread of its own."""

    server: Server
    models: Models
    patience: Patience
    keep: Keep
    arrivals: _Arrivals = field(default_factory=queue.SimpleQueue)
    #: Once set, no request and no retry begins; what is in flight still arrives and is kept.
    over: threading.Event = field(default_factory=threading.Event)
    lacks_a_model: bool = False
    #: The tasks that ask, or keep an answer, each with how far its request is; and the loop in which they do.
    asking: dict[asyncio.Task[Any] | None, Sending] = field(default_factory=dict)
    loop: asyncio.AbstractEventLoop | None = None

    def leave(self) -> None:
        """Begin nothing more, and wait for nothing of which no request is sent; for any thread."""
        self.over.set()
        if self.loop is not None:
            with contextlib.suppress(RuntimeError):  # it has ended just now
                self.loop.call_soon_threadsafe(self._let_go)

    def _let_go(self) -> None:
        for task, sending in self.asking.items():
            if sending.waits and task is not None:
                task.cancel()
        if not all(sending.waits for sending in self.asking.values()):
            _LOG.warning(
                "waiting for the answers in flight, because they are paid for; press Ctrl-C again to leave now"
            )

    def run(self, requests: Sequence[Request], concurrency: int) -> None:
        """Ask until every request has its answer or its fault, or it is over."""
        try:
            asyncio.run(self._ask_all(requests, concurrency))
        except Exception as error:  # the reader must see every error
            self.arrivals.put(error)
        finally:
            self.arrivals.put(None)

    async def _ask_all(self, requests: Sequence[Request], concurrency: int) -> None:
        self.loop = asyncio.get_running_loop()
        self.loop.set_default_executor(ThreadPoolExecutor(_WRITERS))
        left = list(enumerate(requests))

        async def work(waiting: Iterator[tuple[int, Request]]) -> None:
            for position, request in waiting:  # shared: each request goes to the first place that is free
                if self.over.is_set():
                    return
                await self._answer(position, request)

        try:
            # One goes ahead for each choice of settings that may be refused, so that a refusal costs one request.
            while (ahead := next((each for each in left if self.models.is_doubted(each[1])), None)) is not None:
                left.remove(ahead)
                await asyncio.create_task(self._answer(*ahead))
                if self.over.is_set():
                    left = []
            places, waiting = [], iter(left)
            for _ in range(min(concurrency, len(left))):
                places.append(asyncio.create_task(work(waiting)))
                # Thousands that begin in one go outlast the time in which the first must connect.
                await asyncio.sleep(0)
            await asyncio.gather(*places)
            if self.lacks_a_model:
                named = await self.server.models()
                self.models.served = tuple(without_secrets(name, self.server.secrets) for name in named)
        finally:
            await self.server.close()

    async def _answer(self, position: int, request: Request) -> None:
        """Ask, and keep the answer before the reader sees it."""
        try:
            answer = await self._ask(request)
            if not isinstance(answer, Fault):
                answer = await asyncio.to_thread(self.keep, request, answer)
        except asyncio.CancelledError:  # by `_let_go`
            return
        except Exception as error:  # the others in flight are still kept
            self.over.set()
            self.arrivals.put(error)
            return
        finally:
            self.asking.pop(asyncio.current_task(), None)
        if isinstance(answer, Fault):
            self.lacks_a_model = self.lacks_a_model or answer.kind is FaultKind.unknown
            if answer.hopeless or self.models.refuses_choice(request, answer):
                self.over.set()
        self.arrivals.put((position, answer))

    async def _ask(self, request: Request) -> Completion | Fault:
        """Try until there is an answer, or no use in trying."""
        secrets, tried, task = self.server.secrets, 0, asyncio.current_task()
        wanted = settings_of(request, self.server.sampling)
        while True:
            dropped = tuple(name for name in self.models.dropped(request) if name in wanted)
            tried += 1
            begun = time.monotonic()
            self.asking[task] = sending = Sending()
            SENDING.set(sending)
            try:
                completion = await self.server.ask(self.models.sent(request), dropped)
            except FaultError as error:
                fault = replace(error.fault, message=without_secrets(error.fault.message, secrets))
                self.models.heard = self.models.heard or not fault.silent
                del self.asking[task]
            else:
                self.models.note_answer(request, completion, begun)
                return self.models.without_key(replace(completion, dropped=dropped), secrets)
            if self.models.learn(request, wanted - {*dropped}, fault):
                continue
            wait = self.patience.wait(tried, fault, jitter=random.random(), heard=self.models.heard)
            if wait is None:
                return fault
            self.models.report(fault, wait)
            if not await self._waited(wait):
                return fault

    async def _waited(self, seconds: float) -> bool:
        """Wait; return whether the run goes on."""
        end = time.monotonic() + seconds
        while not self.over.is_set() and (left := end - time.monotonic()) > 0:
            await asyncio.sleep(min(left, _LOOK))
        return not self.over.is_set()


#: Seconds for the list of models: without it, a message is only less helpful.
_LISTING = 15.0


class SDKServer:
    """The base of the servers of all SDKs (see `Server`).

    Args:
        clients: asked in turn.
        secrets: what may appear in no message and no answer.
        failures: what the SDK raises, or lets through, where there is no usable answer.
    """

    def __init__(self, clients: Sequence[Any], secrets: tuple[str, ...], failures: tuple[type[Exception], ...]) -> None:
        self._clients = clients
        self.turns = itertools.cycle(clients)
        self.secrets = secrets
        #: The last two as of servers without a list.
        self._unusable: tuple[type[Exception], ...] = (*failures, AttributeError, TypeError)

    async def models(self) -> tuple[str, ...]:
        """Return the names of the models that the server lists; none where it gives no list."""
        try:
            page = await self._clients[0].models.list(timeout=_LISTING)
            return tuple(str(model.id) for model in page.data)
        except self._unusable:
            return ()

    async def close(self) -> None:
        """Close the connections."""
        for client in self._clients:
            await client.close()


#: Requests of one client at once, about.
SHARE = 100

_Client = TypeVar("_Client")


def clients_for(
    concurrency: int, timeout: httpx2.Timeout, sdk: Callable[..., _Client], http: Callable[..., object]
) -> list[_Client]:
    """Make as many clients of an SDK, each with an HTTP client of its own, as so many requests at once need.

    No more requests are sent at once, so no client has to hold any back. The SDK's own retries are off:
    `tacevo.llm.retry` says why. Their bodies have a limit, and what they sent is known (`tacevo.llm.wire`).

    Raises:
        ConfigError: the environment names a proxy, a host without one or certificates that cannot be used.
    """
    context = certificates()  # one for all: it holds every certificate authority
    check_proxies(context, http)
    limits = httpx2.Limits(max_connections=None, max_keepalive_connections=min(concurrency, 2 * SHARE))
    settings = {"limits": limits, "timeout": timeout, "verify": context, "event_hooks": HOOKS}
    return [sdk(max_retries=0, timeout=timeout, http_client=http(**settings)) for _ in range(-(-concurrency // SHARE))]
