"""Requests in Message Batches: slower than one by one, at half the price.

What it promises: the id of a batch is written down as soon as the server returns it, and stays until every answer of
the batch is stored. So the next command reads what a killed or interrupted one has submitted. What it does not: a
submission whose answer is lost (a broken connection, a kill) is made again; if the server has both batches, both are
billed. Two runs at the same time do not share a batch.
"""

import itertools
import random
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import anthropic
import httpx2
from anthropic.types.messages import MessageBatchIndividualResponse, MessageBatchResult
from anthropic.types.messages.batch_create_params import Request as BatchRequest

from tacevo.errors import ConfigError, StoreError, TransportError
from tacevo.llm.anthropic import FAILURES, AnthropicServer, body_of, secrets_of
from tacevo.llm.bodies import read_message
from tacevo.llm.failures import Failures, Models, settings_of
from tacevo.llm.recording import choice, unkept
from tacevo.llm.retry import Fault, FaultError, FaultKind, Patience, fault_of, fault_of_connection, fault_of_status
from tacevo.parts.provider import Keep
from tacevo.records import Completion, Delivery, Record, Request, to_json
from tacevo.redaction import without_secrets
from tacevo.storage.canonical import content_hash, readable
from tacevo.storage.files import write_durably
from tacevo.storage.store import Store
from tacevo.text import counted
from tacevo.typed import parse

#: The number of times that a request is submitted which expires, or on which the server fails.
SUBMISSIONS = 3

#: Requests of one batch; the server takes more, but no more than 256 MB.
MOST_REQUESTS = 5_000

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchRecord(Record):
    """A submitted batch, as a file."""

    id: str
    #: The sampling settings that a request was sent without, by the keys of the requests whose answers are not stored.
    dropped: dict[str, tuple[str, ...]]


@dataclass(slots=True)
class BatchLLM:
    """Answers requests through Message Batches."""

    #: Connects to the server; called for every `complete`.
    connect: Callable[[], anthropic.Anthropic]
    _: KW_ONLY
    #: The store of completions; it tells which answers of a batch are kept.
    store: Store
    #: The directory where submitted batches are written down.
    directory: Path
    #: The facts that are known of the models before the first request.
    models: Models
    patience: Patience = field(default_factory=Patience)
    #: Seconds between two looks at a batch.
    poll: float = 30.0

    def complete(self, requests: Sequence[Request], keep: Keep = unkept) -> Iterator[tuple[int, Completion]]:
        """Answer different requests, batch by batch (see `tacevo.parts.provider.Provider`).

        Raises:
            ConfigError: the server refuses the key, the model, a setting or the payment, or lacks a recorded batch.
            TransportError: the server could not be reached, or had no answer after several submissions.
            StoreError: a record of a batch is damaged, or an answer could not be kept.
        """
        failures = Failures(models=self.models, delivery=Delivery.batch)
        wanted = {self.store.key(to_json(request)): (position, request) for position, request in enumerate(requests)}
        submissions: Counter[str] = Counter()
        with self.connect() as client:
            while wanted and not failures.hopeless:
                begun = time.monotonic()
                for path, record in self._submitted(client, wanted):
                    outcomes = self._outcomes(client, path, record)
                    for key, outcome in outcomes.items():
                        if key not in wanted:
                            continue
                        position, request = wanted[key]
                        if isinstance(outcome, Completion):
                            self.models.note_answer(request, outcome, begun)
                            del wanted[key]
                            yield position, keep(request, outcome)
                        elif not self.models.learn(request, _settings(request) - {*record.dropped[key]}, outcome):
                            submissions[key] += 1
                            if outcome.kind is not FaultKind.passing or submissions[key] == SUBMISSIONS:
                                del wanted[key]
                                failures.add(position, request, outcome)
                    self._settle(path, record, outcomes)
        for position, completion in failures.recorded():
            yield position, keep(requests[position], completion)
        failures.raise_rest(len(requests))

    def _submitted(
        self, client: anthropic.Anthropic, wanted: Mapping[str, tuple[int, Request]]
    ) -> list[tuple[Path, BatchRecord]]:
        """Find the batches that hold wanted requests, and submit the rest."""
        directory = self.directory / content_hash(str(client.base_url))[:16]  # an id means nothing to other servers
        known = [(path, _read(path)) for path in sorted(directory.glob("*.json"))]
        submitted = [(path, record) for path, record in known if record.dropped.keys() & wanted.keys()]
        left = [key for key in wanted if all(key not in record.dropped for _, record in submitted)]
        # One goes ahead for each choice of settings that may be refused, so that a refusal costs one request.
        first = {choice(wanted[key][1]): key for key in reversed(left) if self.models.is_doubted(wanted[key][1])}
        left = [*first.values()] or left
        for start in range(0, len(left), MOST_REQUESTS):
            asked = {key: wanted[key][1] for key in left[start : start + MOST_REQUESTS]}
            dropped = {
                key: tuple(name for name in self.models.dropped(request) if name in _settings(request))
                for key, request in asked.items()
            }
            bodies: list[BatchRequest] = [
                {"custom_id": key, "params": body_of(self.models.sent(request), dropped[key])}
                for key, request in asked.items()
            ]
            record = BatchRecord(id=self._submit(client, bodies), dropped=dropped)
            submitted.append((directory / f"{record.id}.json", record))
            write_durably(submitted[-1][0], readable(to_json(record)))
        return submitted

    def _submit(self, client: anthropic.Anthropic, bodies: list[BatchRequest]) -> str:
        def create() -> str:
            try:
                return client.messages.batches.create(requests=bodies).id
            except anthropic.APIConnectionError as error:
                fault = fault_of(error)
                twice = ". If the server has this batch, it is billed twice" if fault.sent else ""
                raise FaultError(replace(fault, message=f"{fault.message}{twice}")) from None

        return self._call(client, create)

    def _outcomes(self, client: anthropic.Anthropic, path: Path, record: BatchRecord) -> dict[str, Completion | Fault]:
        """Wait for a batch, and read what became of the requests in its record."""
        batches, secrets = client.messages.batches, secrets_of(client)

        def results() -> dict[str, Completion | Fault]:
            read = (each for each in batches.results(record.id) if each.custom_id in record.dropped)
            outcomes = {each.custom_id: self._outcome(each, record, secrets) for each in read}
            if lacking := len(record.dropped) - len(outcomes):
                words = f"the results of batch {record.id} lack {counted(lacking, 'answer')}"
                raise FaultError(Fault(kind=FaultKind.passing, message=words))
            return outcomes

        try:
            while (seen := self._call(client, lambda: batches.retrieve(record.id))).processing_status != "ended":
                time.sleep(self.poll)
            if seen.archived_at is not None:
                raise ConfigError("the server has deleted its results", place=self.models.name)
            return self._call(client, results)
        except ConfigError as error:
            error.place = f"{self.models.name}, batch {record.id}"
            lost = f"if its answers are lost, delete {path} to submit and pay for its requests again"
            error.remedy = f"use the key and the workspace that submitted it, or, {lost}"
            raise

    def _outcome(
        self, result: MessageBatchIndividualResponse, record: BatchRecord, secrets: tuple[str, ...]
    ) -> Completion | Fault:
        """Read what became of one request; what cannot be read would be no better in another reading, so it failed."""
        try:
            outcome = _read_outcome(result.result, record.id)
        except FaultError as error:
            outcome = error.fault
        except (AttributeError, TypeError, ValueError) as error:  # the SDK checks no body
            outcome = fault_of_connection(error)
        if isinstance(outcome, Completion):
            return self.models.without_key(replace(outcome, dropped=record.dropped[result.custom_id]), secrets)
        return replace(outcome, message=without_secrets(outcome.message, secrets))

    def _settle(self, path: Path, record: BatchRecord, outcomes: Mapping[str, Completion | Fault]) -> None:
        """Take off a record what is stored or has no answer; remove it with its last request."""
        left = {
            key: dropped
            for key, dropped in record.dropped.items()
            if isinstance(outcomes[key], Completion) and not self.store.holds(key)
        }
        if left:
            write_durably(path, readable(to_json(replace(record, dropped=left))))
        else:
            path.unlink()

    def _call(self, client: anthropic.Anthropic, function: Callable[[], _T]) -> _T:
        """Make a call, again and again while its failure may pass."""
        for tried in itertools.count(1):
            try:
                done = function()
                self.models.heard = True
                return done
            except FaultError as error:
                fault = error.fault
            except (*FAILURES, httpx2.RequestError) as error:
                fault = fault_of(error)
            fault = replace(fault, message=without_secrets(fault.message, secrets_of(client)))
            self.models.heard = self.models.heard or not fault.silent
            wait = self.patience.wait(tried, fault, jitter=random.random(), heard=self.models.heard)
            if wait is None:
                break
            self.models.report(fault, wait)
            time.sleep(wait)
        if fault.kind is not FaultKind.passing:
            raise ConfigError(fault.message, place=self.models.name, remedy=fault.remedy)
        got = f"a call about a batch failed after all tries, the last with {fault.message}"
        remedy = "repeat the same command: it reads the batches that were submitted"
        raise TransportError(got, place=self.models.name, remedy=remedy)


def _settings(request: Request) -> set[str]:
    return settings_of(request, AnthropicServer.sampling)


def _read_outcome(outcome: MessageBatchResult, batch: str) -> Completion | Fault:
    if outcome.type == "succeeded":
        return read_message(outcome.message.model_dump(warnings=False), Delivery.batch)
    if outcome.type == "errored":
        return fault_of_status(500, {}, outcome.error.error.model_dump(warnings=False))  # its type says which status
    kind = FaultKind.refused if outcome.type == "canceled" else FaultKind.passing  # the user wanted it to end
    return Fault(kind=kind, message=f"a request of batch {batch} was {outcome.type}")


def _read(path: Path) -> BatchRecord:
    remedy = "delete it to submit, and pay for, the requests of its batch again"
    return parse(BatchRecord, path.read_bytes(), place=str(path), error=StoreError, remedy=remedy)
