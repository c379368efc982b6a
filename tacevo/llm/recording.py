"""Recording and replaying: an LLM in front of a store, and behind it the real one."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace

from tacevo.costs import Tally, spending_on, total
from tacevo.errors import LLMError, StoreError
from tacevo.parts.provider import Provider
from tacevo.records import Completion, Json, Price, Request, Setting, to_json
from tacevo.storage.store import Store
from tacevo.typed import convert

#: The fields of a completion that a server writes.
_TEXTS = ("text", "model", "stop_reason")

#: A model, a token limit and further settings.
Choice = tuple[str, int, tuple[tuple[str, Setting], ...]]


def unkept(request: Request, completion: Completion) -> Completion:
    """Return an answer as it came, for a provider that is used without a store."""
    return completion


def choice(request: Request) -> Choice:
    """Return what has to be right for a model to answer a request at all."""
    return request.model, request.max_tokens, request.settings


def ever_answered(store: Store, request: Request) -> bool:
    """Return whether a store holds a text that was answered to the model, token limit and settings of a request."""
    return any(answer.text and choice(asked) == choice(request) for asked, answer in _recorded(store))


def temperature_taken(store: Store, chosen: Choice) -> bool | None:
    """Return whether requests of a choice were answered with their temperature; None where no answer tells."""
    for asked, answer in _recorded(store):
        if (
            asked.temperature is not None
            and choice(asked) == chosen
            and (answer.text or "temperature" in answer.dropped)
        ):
            return "temperature" not in answer.dropped
    return None


def _recorded(store: Store) -> Iterator[tuple[Request, Completion]]:
    """Yield requests with their answers, as far as they can be read: one that cannot proves nothing."""
    for entry in store.sound():
        with contextlib.suppress(StoreError):
            request = convert(Request, entry.request, place="request", error=StoreError)
            yield request, _completion(store, entry.request, entry.answer)


def _completion(store: Store, question: Json, answer: Json) -> Completion:
    try:
        return convert(Completion, answer, place="answer", error=StoreError)
    except StoreError as error:  # only here: to hash each request again would cost a replay time
        error.place = f"{store.path(store.key(question))}, {error.place}"
        error.remedy = "delete that file, and its request is asked again"
        raise


@dataclass(slots=True)
class RecordingLLM:
    """Answers from the store where the store's mode allows it; asks the provider for the rest, and records.

    The provider stores each answer the moment it arrives, before it is yielded, so that nothing that was paid for is
    lost. A replay never reaches the provider. Equal requests are one question: it is asked once, and all get the
    answer, as they would from the store.
    """

    #: Answers what is not recorded; None in a replay.
    inner: Provider | None
    #: The completions, keyed by the whole request.
    store: Store
    _: KW_ONLY
    #: The price of an answer's tokens today, stored with it; None without a price table.
    price: Callable[[Request, Completion], Price | None] | None = None
    #: Called with every answer, recorded or new, before it is yielded.
    count: Callable[[Request, Completion], object] = unkept
    #: Whether it is another server than the provider's own that answers.
    elsewhere: bool = False
    #: The server's name for the model, where requests have a label in its place.
    unlabelled: str | None = None
    #: The count of its answers so far, and of their costs.
    tally: Tally = field(default_factory=Tally)

    def complete(self, requests: Sequence[Request]) -> Iterator[tuple[int, Completion]]:
        """Answer every request; recorded answers come first (see `tacevo.evolution.development.LLM`).

        Raises:
            CacheMissError: the store replays, and an answer was never recorded.
            StoreError: an entry is damaged, or an answer cannot be written.
            LLMError: the provider failed.
        """
        missing: dict[Request, list[int]] = {}
        for position, request in enumerate(requests):
            completion = self._recall(request)
            if completion is None:
                missing.setdefault(request, []).append(position)
            else:
                self.tally.recalled += 1
                self.count(request, completion)
                yield position, completion
        if not missing:
            return
        if self.inner is None:
            raise LLMError(f"{len(missing)} requests without a recorded answer, and no model to ask")
        asked = list(missing)
        for index, completion in self.inner.complete(asked, self._keep):
            self.tally.asked = total([self.tally.asked, spending_on([completion])])
            self.count(asked[index], completion)
            for position in missing[asked[index]]:
                yield position, completion

    def _recall(self, request: Request) -> Completion | None:
        """Return the recorded answer; one that was recorded before the label was chosen is recorded under it, too."""
        question = to_json(request)
        recorded = self.store.find(question)
        if recorded is not None or self.unlabelled is None:
            return None if recorded is None else _completion(self.store, question, recorded)
        before = to_json(replace(request, model=self.unlabelled))
        recorded = self.store.find(before)
        if recorded is None:
            return None
        labelled = replace(_completion(self.store, before, recorded), model=request.model)
        return _completion(self.store, question, self.store.keep(question, to_json(labelled)))

    def _keep(self, request: Request, completion: Completion) -> Completion:
        """Put the price on, replace lone surrogates (half an emoji, say), which no UTF-8 file can hold, and store.

        Where another process has asked the same meanwhile, its answer stands: a ledger may have it already.
        """
        price = None if self.price is None else self.price(request, completion)
        sound = {name: getattr(completion, name).encode(errors="replace").decode() for name in _TEXTS}
        if self.unlabelled is not None:
            sound["model"] = request.model
        kept = replace(completion, **sound, price=price, elsewhere=self.elsewhere)
        question, answer = to_json(request), to_json(kept)
        standing = self.store.keep(question, answer)
        return kept if standing is answer else _completion(self.store, question, standing)
