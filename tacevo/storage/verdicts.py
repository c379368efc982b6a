"""Verdicts on candidates, as stores keep them: `{NAME: what it passed with}`, or `{"rejection": ...}`."""

from collections.abc import Callable
from typing import TypeVar

from tacevo.errors import StoreError, TacevoError
from tacevo.records import Json, Rejection, to_json
from tacevo.storage.store import Store
from tacevo.typed import convert

T = TypeVar("T")


def recall_verdict(
    store: Store, request: Json, kind: type[T], name: str, judge: Callable[[], T | Rejection]
) -> T | Rejection:
    """Return the recorded verdict on a request, or judge and record it, as the store's mode says.

    What a candidate passes with is of the class `kind`, and stands under `name` in the entry. What `judge` raises
    passes through, and nothing is recorded.

    Raises:
        CacheMissError: the store is in replay and has no such verdict.
        StoreError: the entry is damaged.
    """

    def compute() -> Json:
        verdict = judge()
        return {"rejection" if isinstance(verdict, Rejection) else name: to_json(verdict)}

    answer = store.recall(request, compute)
    try:
        return read_verdict(kind, name, answer, place="entry")
    except StoreError as error:  # hashing every long request for a name that is hardly ever told takes a tenth of it
        error.place = error.place.replace("entry", f"entry {store.key(request)[:12]}", 1)
        raise


def read_verdict(
    kind: type[T], name: str, answer: Json, *, place: str, error: type[TacevoError] = StoreError
) -> T | Rejection:
    """Read a verdict from its JSON form; raises `error` where it is malformed."""
    fields = answer if isinstance(answer, dict) else {}
    if "rejection" in fields:
        return convert(Rejection, fields["rejection"], place=f"{place}, rejection", error=error)
    return convert(kind, fields.get(name), place=f"{place}, {name}", error=error)
