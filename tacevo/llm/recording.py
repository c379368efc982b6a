"""Recording and replaying: an LLM in front of a store, and behind it the real one."""

import logging
import queue
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from tacevo.errors import LLMError
from tacevo.records import Completion, Json, Price, Request, to_json
from tacevo.search.effects import LLM
from tacevo.storage.store import Store

_LOG = logging.getLogger(__name__)

#: Entries written at once: a disk takes many synced files in little more time than one.
_WRITERS = 16

#: The fields of a completion that a server writes.
_TEXTS = ("text", "model", "stop_reason")

#: What has to be right for a model to answer at all.
_CHOICE = ("model", "max_tokens", "settings")

#: Indices of the requests that are asked, and their stored completions; failures; None at the end.
_Stored = queue.SimpleQueue[tuple[int, Completion] | Exception | None]


def ever_answered(store: Store, request: Request) -> bool:
    """Say whether a store holds a text that was answered to the model, token limit and settings of a request.

    Raises:
        StoreError: an entry that was looked at is damaged.
    """
    asked = to_json(request)
    return any(
        entry.answer["text"] and all(entry.request.get(name) == asked[name] for name in _CHOICE)
        for entry in store.entries()
    )


def ever_refused(store: Store, choice: Mapping[str, Json], setting: str) -> bool:
    """Return whether a store holds an answer to requests of a choice that was got without a refused sampling setting.

    A model may refuse a temperature beside one setting, such as thinking, and take it without.

    Args:
        store: of completions.
        choice: `model`, `max_tokens` and `settings`, as a request's JSON has them.
        setting: name of the sampling setting.

    Raises:
        StoreError: an entry that was looked at is damaged.
    """
    return any(
        setting in entry.answer.get("dropped", ()) and all(entry.request.get(name) == choice[name] for name in _CHOICE)
        for entry in store.entries()
    )


class RecordingLLM:
    """Answers from the store where the store's mode allows it; asks the inner LLM for the rest, and records.

    Every answer is stored the moment it arrives, before anybody sees it and in a thread of its own, so that nothing
    that was paid for is lost: neither to a slow reader nor to an interruption, which first waits for the answers
    that are in flight. A replay never reaches the inner LLM. Equal requests are one question: it is asked once, and
    all get the answer, as they would from the store.

    Args:
        inner: who answers what is not recorded; None where nobody may, as in a replay.
        store: the completions, keyed by the whole request.
        price: what an answer's tokens cost today, stored with it; None where nobody keeps prices.
        stop: set when a reader leaves early; the inner LLM then begins nothing further.
    """

    def __init__(
        self,
        inner: LLM | None,
        store: Store,
        *,
        price: Callable[[Request, Completion], Price | None] | None = None,
        stop: threading.Event | None = None,
    ) -> None:
        self._inner = inner
        self._store = store
        self._price = price
        self._stop = stop or threading.Event()

    def complete(self, requests: Sequence[Request]) -> Iterator[tuple[int, Completion]]:
        """Answer every request; recorded answers come first (see `tacevo.search.effects.LLM`).

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
        for index, completion in self._ask(self._inner, asked):
            for position in missing[asked[index]]:
                yield position, completion

    def _ask(self, inner: LLM, asked: Sequence[Request]) -> Iterator[tuple[int, Completion]]:
        """Give what another thread asks for and stores; leave no answer behind, whatever happens here."""
        stored: _Stored = queue.SimpleQueue()
        recording = threading.Thread(target=self._record, args=(inner, asked, stored), daemon=True)
        recording.start()
        failed: Exception | None = None
        ended = False
        try:
            while (arrival := stored.get()) is not None:
                if isinstance(arrival, Exception):
                    failed = failed or arrival
                else:
                    yield arrival
            ended = True
        except KeyboardInterrupt:
            _LOG.warning("waiting for the answers that are in flight, for they are paid for; again to leave at once")
            raise
        finally:
            if not ended:
                self._stop.set()
            recording.join()
        if failed is not None:
            raise failed

    def _record(self, inner: LLM, asked: Sequence[Request], stored: _Stored) -> None:
        """Store every answer as it arrives and hand it on; say when that was all."""

        def keep(index: int, answered: Completion) -> None:
            try:
                completion = self._finished(asked[index], answered)
                self._store.write(to_json(asked[index]), to_json(completion))
                stored.put((index, completion))
            except Exception as error:  # whatever it is, whoever waits must hear of it
                self._stop.set()
                stored.put(error)

        try:
            with ThreadPoolExecutor(_WRITERS, "recorder") as writers:
                for index, answered in inner.complete(asked):
                    writers.submit(keep, index, answered)
        except Exception as error:  # as above
            stored.put(error)
        finally:
            stored.put(None)

    def _finished(self, request: Request, completion: Completion) -> Completion:
        """Put the price on, and replace lone surrogates (half an emoji, say), which no UTF-8 file can hold, by `?`."""
        price = None if self._price is None else self._price(request, completion)
        sound = {name: getattr(completion, name).encode(errors="replace").decode() for name in _TEXTS}
        return replace(completion, **sound, price=price)
