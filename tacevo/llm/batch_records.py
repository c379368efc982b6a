"""What is remembered of submitted batches, on disk, so that a killed run finds them again.

A record is written before its batch is submitted, completed with the batch's id, and deleted once every answer is in
the store. It holds no key of an account and no address in the clear.
"""

import json
import secrets
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass, field, replace
from pathlib import Path

from tacevo.errors import ConfigError, StoreError
from tacevo.records import Completion, Json, Request, to_json
from tacevo.search.effects import LLM
from tacevo.storage.files import write_durably
from tacevo.storage.store import Store

#: Raised when the layout of a record changes.
SCHEMA = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchRecord:
    """One batch, submitted or about to be."""

    #: Its file's name, without the ending.
    name: str = field(default_factory=lambda: secrets.token_hex(8))
    #: Hash of the server's address: ids of one server mean nothing to another.
    server: str
    #: Keys of the requests whose answers are not in the store yet; the batch knows its requests by them.
    keys: tuple[str, ...]
    #: How many requests the batch was submitted with.
    requests: int
    #: Sampling settings that were not sent, because the model refuses them.
    dropped: tuple[str, ...]
    #: Ids of the latest batches that stood on the server before this one was submitted.
    known: tuple[str, ...]
    #: None until the server's answer to the submission was written down.
    id: str | None = None


class BatchRecords:
    """The records of one server's batches, as files in a folder.

    Args:
        folder: where; other servers' records may stand there, too.
        server: hash of the server's address.
    """

    def __init__(self, folder: Path, server: str) -> None:
        self._folder = folder
        self.server = server

    def all(self) -> Iterator[BatchRecord]:
        """Give every record of this server.

        Raises:
            StoreError: a record is damaged.
        """
        for path in sorted(self._folder.glob("*.json")):
            record = _read(path)
            if record.server == self.server:
                yield record

    def path(self, record: BatchRecord) -> Path:
        """Say where a record stands."""
        return self._folder / f"{record.name}.json"

    def write(self, record: BatchRecord) -> None:
        """Write a record down, durably."""
        text = json.dumps({"schema": SCHEMA, **to_json(record)}, indent=1)
        write_durably(self.path(record), text + "\n")

    def identify(self, record: BatchRecord, batch: str) -> BatchRecord:
        """Write down which batch a record stands for."""
        identified = replace(record, id=batch)
        self.write(identified)
        return identified

    def remove(self, record: BatchRecord) -> None:
        """Forget a record."""
        self.path(record).unlink(missing_ok=True)

    def settle(self, record: BatchRecord, settled: Set[str]) -> BatchRecord:
        """Take keys off a record whose answers are stored or will never come; forget the record with its last one."""
        left = replace(record, keys=tuple(key for key in record.keys if key not in settled))
        if not left.keys:
            self.remove(left)
        elif left != record:
            self.write(left)
        return left


def _read(path: Path) -> BatchRecord:
    try:
        value: dict[str, Json] = json.loads(path.read_text(encoding="utf-8"))
        if value.pop("schema") != SCHEMA:
            raise ValueError("another schema")
        lists = {name: tuple(value[name]) for name in ("keys", "dropped", "known")}
        return BatchRecord(**{**value, **lists})
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise StoreError(
            f"{path} is no record of a batch ({type(error).__name__}: {error}); restore it from a copy, or delete it: "
            "a batch that it stood for is then submitted, and paid for, again"
        ) from error


class UnbatchedLLM:
    """Refuses requests that stand in a batch and have no stored answer; hands on the others.

    Args:
        inner: who answers.
        store: the completions.
        records: what is remembered of the batches on the server that is asked.
    """

    def __init__(self, inner: LLM, *, store: Store, records: BatchRecords) -> None:
        self._inner = inner
        self._store = store
        self._records = records

    def complete(self, requests: Sequence[Request]) -> Iterator[tuple[int, Completion]]:
        """Answer different requests (see `tacevo.search.effects.LLM`).

        Raises:
            ConfigError: a batch holds some of them.
            StoreError: a record of a batch is damaged.
            LLMError: the inner LLM failed.
        """
        keys = {self._store.key(to_json(request)) for request in requests}
        for record in self._records.all():
            standing = [key for key in keys.intersection(record.keys) if not self._store.holds(key)]
            if standing:
                raise _refusal(len(standing), self._records.path(record))
        yield from self._inner.complete(requests)


def _refusal(standing: int, path: Path) -> ConfigError:
    return ConfigError(
        f"{standing} of the requests to ask stand in a batch that an earlier run submitted; take their answers with "
        f"llm.delivery=batch, or delete {path} to ask, and to pay for, them anew"
    )
