"""The Message Batches API through the official SDK: each call retried, and a submission never made twice blindly."""

import random
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar, cast

import anthropic
import httpx2
from anthropic.types.messages import MessageBatch, MessageBatchIndividualResponse
from anthropic.types.messages.batch_create_params import Request as BatchRequest

from tacevo.errors import ConfigError, LLMError, TransportError
from tacevo.llm.anthropic import FAILURES, fault_of, secrets_of
from tacevo.llm.failures import Notices
from tacevo.llm.hosted import LISTING
from tacevo.llm.retry import Fault, FaultKind, Patience
from tacevo.records import Json
from tacevo.redaction import without_secrets

#: How many of the latest batches are noted before a submission, to recognise a later one.
_KNOWN = 20

#: Statuses that say for certain that a submission was not begun: rate limit, overload.
_NOT_BEGUN = {429, 529}

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """How often a batch is looked at; in seconds."""

    first: float = 5.0
    longest: float = 60.0
    #: What a batch that was just submitted needs to appear in the server's list.
    settling: float = 30.0


class LostSubmissionError(Exception):
    """A submission may have reached the server or not; it never leaves `tacevo.llm`."""


class GoneBatchError(Exception):
    """The server does not know a batch, or no longer has its results; it never leaves `tacevo.llm`."""


class BatchServer:
    """One server's batches.

    Args:
        client: the SDK's client, which makes no retries of its own.
        name: what the user chose, for messages.
        patience: how failed calls are retried.
        pace: how often a batch is looked at.
        stop: once set, waiting ends with an error; the batch goes on at the server.
    """

    def __init__(
        self, client: anthropic.Anthropic, *, name: str, patience: Patience, pace: Pace, stop: threading.Event
    ) -> None:
        self._client = client
        self._name = name
        self._patience = patience
        self._pace = pace
        self._stop = stop
        self._jitter = random.Random()
        self._notices = Notices(name)
        self.secrets = secrets_of(client)

    def latest(self) -> tuple[str, ...]:
        """Give the ids of the latest batches."""
        page = self._call(lambda: self._client.messages.batches.list(limit=_KNOWN))
        return tuple(batch.id for batch in page.data)

    def models(self) -> tuple[str, ...]:
        """Return the names of the models that the server lists; none where it gives no list."""
        try:
            page = self._client.models.list(timeout=LISTING)
            return tuple(without_secrets(str(model.id), self.secrets) for model in page.data)
        except (*FAILURES, AttributeError, TypeError):
            return ()

    def submit(self, bodies: Mapping[str, Json]) -> str:
        """Submit a batch once, and give its id.

        Args:
            bodies: what to ask, by the names that the results will carry.

        Raises:
            LostSubmissionError: the server may have it or not.
            ConfigError: the server refuses it, and has none.
        """
        requests = [cast(BatchRequest, {"custom_id": key, "params": body}) for key, body in bodies.items()]
        tried = 0
        while True:
            tried += 1
            try:
                return str(self._client.messages.batches.create(requests=requests).id)
            except FAILURES as error:
                fault = self._fault(error)
                if fault.kind is FaultKind.passing and getattr(error, "status_code", None) not in _NOT_BEGUN:
                    raise LostSubmissionError(fault.message) from None
            self.wait_or_raise(tried, fault)

    def younger_than(self, known: Sequence[str], requests: int) -> list[str]:
        """Find batches of so many requests that were submitted after others were known, the oldest first.

        Those whose results the server has deleted are among them; `wait_for` tells which they are.
        """
        self._wait(self._pace.settling)

        def look() -> list[str]:
            found = []
            for batch in self._client.messages.batches.list(limit=100):
                if batch.id in known:
                    break
                if sum(batch.request_counts.model_dump().values()) == requests:
                    found.append(batch.id)
            return found[::-1]

        return self._call(look)

    def wait_for(self, batch: str) -> None:
        """Wait until a batch has ended.

        Raises:
            LLMError: the run was stopped; the batch goes on.
            GoneBatchError: there will be no results.
        """
        pause = self._pace.first
        while (seen := self._look(batch)).processing_status != "ended":
            self._wait(pause)
            pause = min(1.5 * pause, self._pace.longest)
        if seen.archived_at is not None:
            raise GoneBatchError("the server has deleted its results")

    def results(self, batch: str) -> Iterator[MessageBatchIndividualResponse]:
        """Give the results of a batch that has ended, in the server's order; after a broken line, from the start.

        Raises:
            GoneBatchError: there are none any more.
        """
        tried = 0
        while True:
            tried += 1
            try:
                yield from self._client.messages.batches.results(batch)
                return
            except (*FAILURES, httpx2.TransportError) as error:
                fault = self._fault_about_batch(error)
            self.wait_or_raise(tried, fault)

    def _look(self, batch: str) -> MessageBatch:
        return self._call(lambda: self._client.messages.batches.retrieve(batch), self._fault_about_batch)

    def _call(self, function: Callable[[], _T], read: Callable[[Exception], Fault] | None = None) -> _T:
        """Make a call that may be repeated; `read` reads its errors where they mean more than those of other calls."""
        tried = 0
        while True:
            tried += 1
            try:
                return function()
            except FAILURES as error:
                fault = (read or self._fault)(error)
            self.wait_or_raise(tried, fault)

    def _fault_about_batch(self, error: Exception) -> Fault:
        """Read a failure of a call that names a batch."""
        if getattr(error, "status_code", None) == 404:
            raise GoneBatchError("the server does not know it (404)") from None
        return self._fault(error)

    def _fault(self, error: Exception) -> Fault:
        fault = fault_of(error)
        return replace(fault, message=without_secrets(fault.message, self.secrets))

    def wait_or_raise(self, tried: int, fault: Fault) -> None:
        """Wait before another try, or say why there is none."""
        if fault.kind is not FaultKind.passing:
            raise ConfigError(f"{self._name}: the server refuses the batch, the key or the model: {fault.message}")
        wait = self._patience.wait(tried, fault, jitter=self._jitter.random())
        if wait is None:
            raise TransportError(
                f"{self._name}: a call about a batch failed after all tries, the last with {fault.message}; give the "
                "same command again: what was submitted is remembered"
            )
        self._notices.tell(fault, wait)
        self._wait(wait)

    def _wait(self, seconds: float) -> None:
        if self._stop.wait(seconds):
            raise LLMError(f"{self._name}: interrupted; submitted batches go on: the same command takes their answers")
