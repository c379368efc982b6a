"""Recording and replaying: an LLM in front of a store, and behind it the real one."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from tacevo.errors import LLMError
from tacevo.llm.client import LLM
from tacevo.records import Completion, Request, to_json
from tacevo.store import Store


class RecordingLLM:
    """Answers from the store where the store's mode allows it; asks the inner LLM for the rest, and records.

    Every answer is stored the moment it arrives, before anybody sees it, so that nothing that was paid for is
    lost. A replay never reaches the inner LLM. Equal requests are one question: it is asked once, and all get the
    answer, as they would from the store.

    Args:
        inner: who answers what is not recorded; None where nobody may, as in a replay.
        store: the completions, keyed by the whole request.
    """

    def __init__(self, inner: LLM | None, store: Store) -> None:
        self._inner = inner
        self._store = store

    def complete(self, requests: Sequence[Request]) -> Iterator[tuple[int, Completion]]:
        """Answer every request; recorded answers come first (see `tacevo.llm.client.LLM`).

        Raises:
            CacheMissError: the store replays, and an answer was never recorded.
            StoreError: an entry is damaged.
            LLMError: the inner LLM failed.
        """
        missing: dict[Request, list[int]] = {}
        for position, request in enumerate(requests):
            recorded = self._store.find(to_json(request))
            if recorded is None:
                missing.setdefault(request, []).append(position)
            else:
                yield position, Completion.from_json(recorded)
        if not missing:
            return
        if self._inner is None:
            raise LLMError(f"{len(missing)} requests are not recorded, and there is no model to ask")
        asked = list(missing)
        for index, answered in self._inner.complete(asked):
            completion = _writable(answered)
            self._store.write(to_json(asked[index]), to_json(completion))
            for position in missing[asked[index]]:
                yield position, completion


def _writable(completion: Completion) -> Completion:
    """Replace lone surrogates (half an emoji, say), which no UTF-8 file can hold, by question marks."""
    return replace(completion, text=completion.text.encode(errors="replace").decode())
