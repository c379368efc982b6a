"""Requests in Message Batches: slower than one by one, at half the price.

What it promises: a batch is remembered on disk before it is submitted, so a run that is killed at any moment finds it
again and neither submits it nor pays for it twice; an interruption leaves it running. A killed submission is found
again by its size and by its place in the server's list, and recognised for certain by the names in its results, for
which it must have ended. What it does not: two runs at the same time do not share a batch; and after a submission that
was cut off, a batch that the server does not list is submitted again, with a warning: one that appears only after the
time that `Pace.settling` gives it, one that was deleted, or one of another key or workspace.
"""

import logging
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from pathlib import Path

import anthropic
from anthropic.types.messages import MessageBatchIndividualResponse

from tacevo.errors import ConfigError
from tacevo.llm.anthropic import body_of, completion_of
from tacevo.llm.batch_records import BatchRecord, BatchRecords
from tacevo.llm.batch_server import BatchServer, GoneBatchError, LostSubmissionError, Pace
from tacevo.llm.failures import Failures, Models, scrubbed
from tacevo.llm.retry import Fault, FaultError, FaultKind, Patience, fault_of_connection, fault_of_status
from tacevo.records import Completion, Delivery, Request, to_json
from tacevo.redaction import without_secrets
from tacevo.storage.canonical import content_hash
from tacevo.storage.store import Store
from tacevo.text import counted

_LOG = logging.getLogger(__name__)

#: How often a request is submitted anew, where the server failed on it or ran out of time.
SUBMISSIONS = 3

#: Requests of one batch; the server takes more, but no more than 256 MB.
MOST_REQUESTS = 5_000

#: The statuses that the server would give a request by itself, by the types of errors in a batch.
_STATUSES = {
    "invalid_request_error": 400,
    "authentication_error": 401,
    "billing_error": 402,
    "permission_error": 403,
    "not_found_error": 404,
    "request_too_large": 413,
    "rate_limit_error": 429,
    "overloaded_error": 529,
}


@dataclass(slots=True, kw_only=True)
class _Round:
    """What one call of `complete` still waits for."""

    #: Requests by their keys, with their positions.
    open: dict[str, tuple[int, Request]]
    failures: Failures
    #: How often a request was submitted without an answer, by key.
    failed: dict[str, int] = field(default_factory=dict)

    def fail(self, key: str, fault: Fault, *, final: bool) -> None:
        """Note that a request got no answer; one that is not final is submitted again, a few times."""
        self.failed[key] = self.failed.get(key, 0) + 1
        if final or self.failed[key] >= SUBMISSIONS:
            position, request = self.open.pop(key)
            self.failures.models.note_refusal(request)
            self.failures.add(position, request, fault)

    def awaited(self, record: BatchRecord) -> set[str]:
        """Give the keys of a record that are waited for."""
        return self.open.keys() & record.keys


class BatchLLM:
    """Answers requests through Message Batches.

    Args:
        connect: connects to the server; called for every `complete`.
        store: where the answers are kept by whoever reads them; tells which records may be forgotten.
        folder: where submitted batches are remembered.
        name: what the user chose, for messages.
        patience: how failed calls are retried.
        pace: how often a batch is looked at.
        models: what is known of the models before the first request.
        stop: once set, waiting ends; batches go on at the server.
    """

    def __init__(
        self,
        connect: Callable[[], anthropic.Anthropic],
        *,
        store: Store,
        folder: Path,
        name: str,
        patience: Patience | None = None,
        pace: Pace | None = None,
        models: Models | None = None,
        stop: threading.Event | None = None,
    ) -> None:
        self._connect = connect
        self._store = store
        self._folder = folder
        self._name = name
        self._patience = patience or Patience()
        self._pace = pace or Pace()
        self._stop = stop or threading.Event()
        self._models = models or Models()

    def complete(self, requests: Sequence[Request]) -> Iterator[tuple[int, Completion]]:
        """Answer different requests, batch by batch (see `tacevo.search.effects.LLM`).

        Raises:
            ConfigError: the server refuses the key, the model, a setting or the payment.
            TransportError: the server could not be reached, or had no answer after several submissions.
            LLMError: the run was interrupted.
            StoreError: a record of a batch is damaged.
        """
        failures = Failures(name=self._name, models=self._models, delivery=Delivery.batch)
        keyed = {self._store.key(to_json(request)): (position, request) for position, request in enumerate(requests)}
        round_ = _Round(open=keyed, failures=failures)
        with self._connect() as client:
            server = BatchServer(client, name=self._name, patience=self._patience, pace=self._pace, stop=self._stop)
            records = BatchRecords(self._folder, content_hash(str(client.base_url)))
            self._forget_stored(records)
            while round_.open and not failures.hopeless:
                yield from self._ask_once(round_, server, records)
            if failures.lack_a_model:
                self._models.served = server.models()
        yield from failures.recorded()
        failures.raise_rest(len(requests), interrupted=False)

    def _forget_stored(self, records: BatchRecords) -> None:
        """Forget what an earlier call or run has brought home."""
        for record in records.all():
            records.settle(record, {key for key in record.keys if self._store.holds(key)})

    def _ask_once(self, round_: _Round, server: BatchServer, records: BatchRecords) -> Iterator[tuple[int, Completion]]:
        """Take the answers of the batches that stand, and of new ones for the requests that are in none."""
        begun = self._models.now()  # refusals of this round, if any, came before whatever is submitted now
        standing = [self._found(record, server, records) for record in records.all() if round_.awaited(record)]
        asked = {key for record in standing if record is not None for key in record.keys}
        for keys in _portions(round_.open, asked):
            standing.append(self._submit(keys, round_, server, records))
        for record in standing:
            if record is not None:
                yield from self._take(record, round_, server, records, begun)

    def _submit(
        self, keys: Sequence[str], round_: _Round, server: BatchServer, records: BatchRecords
    ) -> BatchRecord | None:
        """Remember a batch, submit it, and remember its id; None where it did not get there."""
        dropped = self._models.dropped(round_.open[keys[0]][1])
        record = BatchRecord(
            server=records.server, keys=tuple(keys), requests=len(keys), dropped=dropped, known=server.latest()
        )
        records.write(record)
        try:
            batch = server.submit({key: body_of(round_.open[key][1], dropped) for key in keys})
        except LostSubmissionError as lost:
            found = self._found(record, server, records)
            if found is None:
                for key in keys:
                    round_.fail(key, fault_of_connection(lost), final=False)
            return found
        except ConfigError:
            records.remove(record)  # refused as a whole, so there is nothing to find again
            raise
        return records.identify(record, batch)

    def _found(self, record: BatchRecord, server: BatchServer, records: BatchRecords) -> BatchRecord | None:
        """Find the batch of a record that has no id, because its submission was cut off; forget it if there is none.

        A candidate that goes while it is waited for may have been the one. Where no other is, the record takes its id,
        so that this command and every later one refuses, and nothing is submitted, until a person deletes the record.
        """
        if record.id is not None:
            return record
        others = {other.id for other in records.all()}
        gone = None
        for batch in server.younger_than(record.known, record.requests):
            if batch in others:
                continue
            try:
                server.wait_for(batch)
                names = {result.custom_id for result in server.results(batch)}
            except GoneBatchError:
                gone = batch
                continue
            if names >= {*record.keys}:
                return records.identify(record, batch)
        if gone is not None:
            return records.identify(record, gone)
        _LOG.warning(
            "%s: no batch found for %s whose submission was cut off, so what is wanted of them "
            "is submitted again; a batch of another key or workspace would not be seen, and be paid for twice",
            self._name,
            counted(len(record.keys), "request"),
        )
        records.remove(record)
        return None

    def _take(
        self, record: BatchRecord, round_: _Round, server: BatchServer, records: BatchRecords, begun: int
    ) -> Iterator[tuple[int, Completion]]:
        """Wait for a batch, and take the answers that are wanted; what came to nothing leaves the record.

        Results that lack an answer, or hold it unreadable, are read anew: the answer is paid for.

        Raises:
            ConfigError: the server has no such batch, or not for this key.
        """
        try:
            yield from self._read_all(record, round_, server, records, begun)
        except GoneBatchError as error:
            raise ConfigError(
                f"{self._name}: batch {record.id} holds {counted(len(record.keys), 'request')}, perhaps paid for, but "
                f"{error}: give the key, or the workspace, that submitted it; or, if its answers are lost, delete "
                f"{records.path(record)} to submit, and to pay for, them anew"
            ) from error

    def _read_all(
        self, record: BatchRecord, round_: _Round, server: BatchServer, records: BatchRecords, begun: int
    ) -> Iterator[tuple[int, Completion]]:
        batch = str(record.id)
        server.wait_for(batch)
        nothing: set[str] = set()
        tried = 0
        while lacking := round_.awaited(record) - nothing:
            if tried:
                said = f"the results of batch {batch} lack {counted(len(lacking), 'answer')}, or hold them unreadable"
                server.wait_or_raise(tried, Fault(kind=FaultKind.passing, message=said))
            tried += 1
            for result in server.results(batch):
                key = result.custom_id
                if key not in round_.open or key in nothing:
                    continue
                position, request = round_.open[key]
                try:
                    completion = self._read(result, request, record.dropped)
                except FaultError as error:
                    if result.result.type != "succeeded":
                        nothing.add(key)
                        self._note_nothing(result, error.fault, record, round_, server)
                else:
                    self._models.note_answer(request, begun)
                    del round_.open[key]
                    yield position, scrubbed(completion, server.secrets)
        records.settle(record, nothing)

    def _note_nothing(
        self,
        result: MessageBatchIndividualResponse,
        fault: Fault,
        record: BatchRecord,
        round_: _Round,
        server: BatchServer,
    ) -> None:
        """Note that a request of a batch has no answer; it is submitted again where that may help."""
        _, request = round_.open[result.custom_id]
        told = replace(fault, message=without_secrets(fault.message, server.secrets))
        if not self._models.learn(request, _wanted(request) - {*record.dropped}, told):
            final = told.kind is not FaultKind.passing or result.result.type == "canceled"
            round_.fail(result.custom_id, told, final=final)

    def _read(self, result: MessageBatchIndividualResponse, request: Request, dropped: tuple[str, ...]) -> Completion:
        """Read what became of one request.

        Raises:
            FaultError: it has no answer.
        """
        outcome = result.result
        if outcome.type == "succeeded":
            completion = completion_of(outcome.message, Delivery.batch)
            return replace(completion, dropped=tuple(name for name in dropped if name in _wanted(request)))
        if outcome.type == "errored":
            error = outcome.error.error
            raise FaultError(fault_of_status(_STATUSES.get(error.type, 500), {}, error.model_dump()))
        raise FaultError(Fault(kind=FaultKind.passing, message=f"a batch's request that was {outcome.type}"))


def _wanted(request: Request) -> set[str]:
    return {"temperature", *dict(request.settings)}


def _portions(wanted: Mapping[str, tuple[int, Request]], asked: Set[str]) -> list[list[str]]:
    """Divide the keys that are in no batch into batches: by model, and not too large."""
    by_model: dict[str, list[str]] = {}
    for key, (_, request) in wanted.items():
        if key not in asked:
            by_model.setdefault(request.model, []).append(key)
    return [
        keys[start : start + MOST_REQUESTS]
        for keys in by_model.values()
        for start in range(0, len(keys), MOST_REQUESTS)
    ]
