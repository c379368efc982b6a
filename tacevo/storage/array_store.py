"""Arrays in a store, each under a question that holds the SHA-256 of its bytes, so that none can be exchanged unseen.

The bytes are little-endian and row-major, and stand in an entry as base64. They are not compressed there: builds of one
library compress equal bytes differently, and entries of one key must be equal. A bundle compresses all its entries.
"""

import base64
import hashlib
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args

import numpy as np
from annotated_types import Ge, Lt
from numpy.typing import NDArray
from pydantic import StringConstraints

from tacevo.errors import CacheMissError, StoreError
from tacevo.records import Json, Record, to_json
from tacevo.storage.store import Entry, Store
from tacevo.typed import convert

#: The kind of the store that holds arrays.
KIND = "arrays"

#: The types of an array's values: float32 or int64, little-endian.
Type = Literal["<f4", "<i8"]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Question(Record):
    """The key of an array."""

    #: The digest of the array's bytes.
    sha256: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
    dtype: Type
    shape: tuple[Annotated[int, Ge(0), Lt(2**53)], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Content(Record):
    """The content of an array."""

    base64: str


class ArrayStore:
    """Keeps arrays in a store of the kind `arrays`, and reads them; an array is named by the digest of its bytes."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def keep(self, array: NDArray[Any]) -> str:
        """Keep an array of float32 or int64, durably; return its digest.

        Raises:
            StoreError: the entry that stands in its place is damaged, or it cannot be written.
        """
        data, dtype = _bytes(array)
        digest = hashlib.sha256(data).hexdigest()
        content = to_json(_Content(base64=base64.b64encode(data).decode()))
        self._store.recall(_request(digest, dtype, array.shape), lambda: content)
        return digest

    def read(self, digest: str, dtype: Type, shape: tuple[int, ...]) -> NDArray[Any]:
        """Read an array, whatever the mode of the store.

        Raises:
            CacheMissError: the store lacks it.
            StoreError: its entry is damaged, or holds other bytes than its question says, or NaN or infinity.
        """
        request = _request(digest, dtype, shape)
        place = f"{KIND} {self._store.key(request)[:12]}"
        answer = self._store.read(request)
        if answer is None:
            expected = f"an array of shape {shape}, SHA-256 {digest[:12]}"
            raise CacheMissError("no entry in this store", place=place, expected=expected)
        return _content(request, answer, place)


def digest_of(array: NDArray[Any]) -> str:
    """Return the digest that an array of float32 or int64 is kept under."""
    return hashlib.sha256(_bytes(array)[0]).hexdigest()


def check_array(entry: Entry, place: str) -> None:
    """Check that an entry of the kind `arrays` holds what its question says.

    Raises:
        StoreError: it does not.
    """
    _content(entry.request, entry.answer, place)


def _request(digest: str, dtype: Type, shape: tuple[int, ...]) -> Json:
    return to_json(_Question(sha256=digest, dtype=dtype, shape=shape))


def _bytes(array: NDArray[Any]) -> tuple[bytes, Type]:
    for dtype in get_args(Type):
        if array.dtype == np.dtype(dtype):
            return array.astype(dtype).tobytes(), dtype
    raise ValueError(f"expected an array of float32 or int64; got {array.dtype}")


def _content(request: Json, answer: Json, place: str) -> NDArray[Any]:
    """Decode an entry; raises `StoreError` where it is not what its question says."""
    question = convert(_Question, request, place=f"{place}, request", error=StoreError)
    content = convert(_Content, answer, place=f"{place}, answer", error=StoreError)
    expected = f"the {question.dtype} of shape {question.shape} whose digest stands in the request"
    try:
        data = base64.b64decode(content.base64, validate=True)
        if (came := hashlib.sha256(data).hexdigest()) != question.sha256:
            raise ValueError(f"bytes of the digest {came[:12]}, not {question.sha256[:12]}")
        array = np.frombuffer(data, question.dtype).reshape(question.shape)
    except ValueError as error:
        raise StoreError(str(error), place=place, expected=expected) from error
    if (broken := int((~np.isfinite(array)).sum())) > 0:
        raise StoreError(f"{broken} of {array.size} that are NaN or infinite", place=place, expected="finite numbers")
    return array
