"""An LLM that asks directly, but nothing that a batch of an earlier run is to answer: it would be paid for twice."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from tacevo.errors import ConfigError
from tacevo.llm.batch_records import BatchRecords
from tacevo.llm.client import LLM
from tacevo.records import Completion, Request, to_json
from tacevo.store import Store


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
        """Answer different requests (see `tacevo.llm.client.LLM`).

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
