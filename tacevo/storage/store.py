"""A store of answers under the content hash of their questions.

What it promises: an entry, once `write` returns, survives a crash; a reader never sees half of one; two
processes may share a store; nothing expires; what a killed writer left is removed. What it does not: no lock spans
a computation, so two processes that miss at the same moment both compute, and the answer that lands last (for a pure
function: an equal one) stays. On a file system without `flock` nothing is removed, because it is not known there
which writer lives.
"""

import contextlib
import hashlib
import itertools
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tacevo.errors import CacheMissError, StoreError
from tacevo.records import Json, Mode, Record
from tacevo.storage.canonical import canonical, content_hash, differences, readable, shown
from tacevo.storage.files import remove_leftovers, write_durably
from tacevo.storage.members import Member
from tacevo.typed import UncheckedJson, parse

#: Raised when the meaning of a key or the layout of an entry changes; part of every key.
SCHEMA = 1

#: Called with the path of an entry that was read.
Seen = Callable[[Path], object]

#: The kinds of answers that a search keeps.
SEARCHED = ("answers", "centroids", "completions", "evaluations", "probes")

#: All kinds of answers: those of every search, what parts of a user decide, what servers tell of their models, and the
#: full trainings of studies with the arrays that these keep.
KINDS = (*SEARCHED, "arrays", "decisions", "models", "studies")

#: The remedy for a damaged entry.
_RESTORE = "restore the file from a copy, or delete it so that it is computed again"

#: The number of entries with which a miss is compared, at most, to name the nearest; that takes some seconds.
_COMPARED = 20_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry(Record):
    """A question of one kind, and its answer; who writes or hashes it finds numbers that are not finite."""

    kind: str
    request: UncheckedJson
    answer: UncheckedJson

    @property
    def key(self) -> str:
        """Name the question."""
        return _key(self.kind, self.request)

    @property
    def place(self) -> str:
        """The path of the entry below the root of the stores."""
        return place_of(self.kind, self.key)

    def sealed(self) -> dict[str, Json]:
        """Return all that its file holds."""
        # The canonical form of an object is made of those of its values, so that a long request is written once.
        kind, request, answer = map(canonical, (self.kind, self.request, self.answer))
        key = _sha256(f'{{"kind":{kind},"request":{request},"schema":{SCHEMA}}}')
        checksum = _sha256(f'{{"answer":{answer},"key":"{key}","kind":{kind},"request":{request},"schema":{SCHEMA}}}')
        return {
            "schema": SCHEMA,
            "kind": self.kind,
            "key": key,
            "request": self.request,
            "answer": self.answer,
            "checksum": checksum,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sealed(Record):
    """The content of an entry's file."""

    schema: Literal[1]
    kind: str
    key: str
    request: UncheckedJson
    answer: UncheckedJson
    checksum: str


def place_of(kind: str, key: str) -> str:
    """Return where the entry of a key stands below the root of the stores, e.g. `probes/0a/0a1b....json`."""
    return f"{kind}/{key[:2]}/{key}.json"


class Store:
    """One kind of answers (`completions`, `evaluations`, ...) as readable JSON files, by key.

    Args:
        root: the directory that holds all kinds.
        kind: the name of this kind; part of every key.
        seen: called with every entry that `read` finds, from the thread that reads.
    """

    def __init__(self, root: Path, kind: str, mode: Mode = Mode.record, *, seen: Seen | None = None) -> None:
        self._root, self._folder = root, root / kind
        self._kind = kind
        self._mode = mode
        self._seen = seen

    def key(self, request: Json) -> str:
        """Name a request: SHA-256 of its canonical JSON with the kind and the schema."""
        return _key(self._kind, request)

    def recall(self, request: Json, compute: Callable[[], Json]) -> Json:
        """Answer a request from the store, or by `compute` where the mode allows it.

        Args:
            request: everything that determines the answer, as JSON.
            compute: returns the answer as JSON; an exception it raises passes through and nothing is stored.

        Raises:
            CacheMissError: the mode is `replay` and the answer was never recorded.
            StoreError: the entry is damaged.
        """
        answer = self.find(request)
        return self.keep(request, compute()) if answer is None else answer

    def find(self, request: Json) -> Json | None:
        """Look a request up as the mode says; None means that it is to be computed.

        Raises:
            CacheMissError: the mode is `replay` and the answer was never recorded.
            StoreError: the entry is damaged.
        """
        if self._mode is Mode.live:
            return None
        answer = self.read(request)
        if answer is None and self._mode is Mode.replay:
            raise self._miss(request)
        return answer

    def read(self, request: Json) -> Json | None:
        """Read the recorded answer to a request, whatever the mode; None where there is none.

        Raises:
            StoreError: the entry is damaged or of another schema.
        """
        key = self.key(request)
        path = self.path(key)
        try:
            data = path.read_bytes()
        except FileNotFoundError:
            return None
        answer = check_entry(path, data, self._kind, key).answer
        if self._seen is not None:
            self._seen(path)
        return answer

    def holds(self, key: str) -> bool:
        """Return whether there is an entry of a key, sound or not."""
        return self.path(key).exists()

    def write(self, request: Json, answer: Json, *, replace: bool = True) -> bool:
        """Record an answer, durably and in one step, and return whether it was; `replace` as of `write_durably`."""
        entry = Entry(kind=self._kind, request=request, answer=answer)
        return write_entry(self._root, entry, replace=replace)

    def keep(self, request: Json, answer: Json) -> Json:
        """Record an answer, and return the one that stands: this one in mode `live`, else the first of all processes.

        Another process may have recorded one since this one looked, and gone on with it.

        Raises:
            StoreError: that entry is damaged; or nothing can be written.
        """
        if self.write(request, answer, replace=self._mode is Mode.live):
            return answer
        standing = self.read(request)
        if standing is None:  # a name without a file (a link of git-annex, say), or it was removed meanwhile
            self.write(request, answer)
            return answer
        return standing

    def entries(self) -> Iterator[Entry]:
        """Yield every entry, checked, in the order of their keys.

        Raises:
            StoreError: an entry is damaged or of another schema.
        """
        for path in sorted(self._folder.glob("*/*.json")):
            yield read_entry(path)

    def sound(self, most: int | None = None) -> Iterator[Entry]:
        """Yield entries in the order of their keys, at most so many files, without those that are damaged."""
        for path in itertools.islice(sorted(self._folder.glob("*/*.json")), most):
            with contextlib.suppress(StoreError, OSError):
                yield read_entry(path)

    def path(self, key: str) -> Path:
        """Return where the entry of a key stands, if there is one."""
        return self._root / place_of(self._kind, key)

    def _miss(self, request: Json) -> CacheMissError:
        """Name the recording that differs in the fewest fields, and the first one in which it does."""
        missed = f"no recorded answer for {self._kind} request {self.key(request)[:12]}"
        compared = ((entry, differences(entry.request, request)) for entry in self.sound(_COMPARED))
        nearest = min((pair for pair in compared if pair[1]), key=lambda pair: len(pair[1]), default=None)
        if nearest is None:
            remedy = "that store is empty or absent: name it by store.root (in a replay, --store)"
            return CacheMissError(missed, place=str(self._folder), remedy=remedy)
        entry, fields = nearest
        return CacheMissError(
            f"{missed}; the nearest recording is {entry.key[:12]}, whose field {shown(fields[0])!r} differs",
            place=str(self._folder),
            remedy="replay with the configuration of the recording, or record again with llm.mode=record",
        )


@dataclass(frozen=True, slots=True)
class Stores:
    """The stores of all kinds in a directory, or in a bundle."""

    root: Path
    #: Called with the path of every entry that is read.
    seen: Seen | None = None

    def of(self, kind: str, mode: Mode) -> Store:
        """Return that of a kind."""
        return Store(self.root, kind, mode, seen=self.seen)


def remove_leftovers_in_stores(root: Path) -> None:
    """Remove what killed writers left in the stores, and in the records of batches, below `root`.

    Every search does so, and a store can hold a million entries: only its own directory is looked through.
    """
    for kind in KINDS:
        remove_leftovers(root / kind, is_deep=False)
    remove_leftovers(root / "batches")


def write_entry(root: Path, entry: Entry, *, replace: bool = True) -> bool:
    """Write an entry into the stores below `root`, and return whether it was; `replace` as of `write_durably`."""
    sealed = entry.sealed()
    path = root / place_of(entry.kind, str(sealed["key"]))
    return write_durably(path, readable(sealed), replace=replace, begun_in=root / entry.kind)


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _key(kind: str, request: Json) -> str:
    return content_hash({"schema": SCHEMA, "kind": kind, "request": request})


def read_entry(path: Path) -> Entry:
    """Read the entry in a file of a store, by `check_entry`."""
    return check_entry(path, path.read_bytes(), path.parts[-3], path.stem)


def check_entry(path: Path, data: bytes, kind: str, key: str) -> Entry:
    """Read an entry, and compare it with its checksum, its place and its question.

    Those of a bundle were compared when it was opened (`tacevo.storage.entries.unpack_in_memory`).

    Raises:
        StoreError: it is damaged, of another schema, or answers another question than its key stands for.
    """
    if isinstance(path, Member):
        return Entry(**json.loads(data))
    read = parse(_Sealed, data, place=str(path), error=StoreError, remedy=_RESTORE)
    entry = Entry(kind=read.kind, request=read.request, answer=read.answer)
    with contextlib.suppress(ValueError):  # NaN has no canonical form, hence no checksum
        sealed = entry.sealed()
        if (kind, key, read.key, read.checksum) == (read.kind, read.key, sealed["key"], sealed["checksum"]):
            return entry
    expected = "an entry that fits its name and its checksum"
    raise StoreError(_misfit(read, kind, key), place=str(path), expected=expected, remedy=_RESTORE)


def _misfit(read: _Sealed, kind: str, key: str) -> str:
    """Say what does not fit in a damaged entry."""
    if read.kind != kind:
        return f"kind {read.kind!r} in the directory of kind {kind!r}"
    if read.key != key:
        return f"an entry with the key {read.key!r}: it was renamed or edited"
    return f"content that does not fit its key {key[:12]} and its checksum: it was edited or damaged"
