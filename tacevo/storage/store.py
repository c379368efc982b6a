"""A store of answers under the content hash of their questions.

What it promises: an entry, once `write` returns, survives a crash; a reader never sees half of one; two
processes may share a store; nothing expires; what a killed writer left is swept up. What it does not: no lock spans
a computation, so two processes that miss at the same moment both compute, and the answer that lands last (for a pure
function: an equal one) stays. On a file system without `flock` nothing is swept up, because nobody can tell there
whose writer lives.
"""

import contextlib
import itertools
import json
from collections.abc import Callable, Iterator
from pathlib import Path

from tacevo.errors import CacheMissError, StoreError
from tacevo.records import Json, Mode
from tacevo.storage.canonical import Field, content_hash, differences, readable, shown
from tacevo.storage.files import sweep, write_durably

#: Raised when the meaning of a key or the layout of an entry changes; part of every key.
SCHEMA = 1

#: Is told the path of an entry that was read.
Seen = Callable[[Path], object]

#: The kinds of answers that a search keeps.
SEARCHED = ("answers", "centroids", "completions", "evaluations", "probes")

#: All kinds of answers: those of a search, and the full trainings of studies.
KINDS = (*SEARCHED, "studies")

#: What a user may do about a miss: where there is no recording at all, and where there are others.
EMPTY = "that store is empty or not there: name it by store.root (in a replay, --store)"

OTHERWISE = "replay with the configuration of the recording, or record anew with llm.mode=record"

#: How many entries a miss is compared with, at most, to name the nearest; that takes some seconds.
_COMPARED = 20_000


class Store:
    """One kind of answers (`completions`, `evaluations`, ...) as readable JSON files, by key.

    Args:
        root: the folder that holds all kinds.
        kind: the name of this kind; part of every key.
        mode: see `Mode`.
        seen: told of every entry that `read` finds, from whichever thread reads.
    """

    def __init__(self, root: Path, kind: str, mode: Mode = Mode.record, *, seen: Seen | None = None) -> None:
        self._folder = root / kind
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
            compute: gives the answer as JSON; an exception it raises passes through and nothing is stored.

        Raises:
            CacheMissError: the mode is `replay` and the answer was never recorded.
            StoreError: the entry is damaged.
        """
        answer = self.find(request)
        if answer is None:
            answer = compute()
            self.write(request, answer)
        return answer

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
            raise CacheMissError(self._explain_miss(request))
        return answer

    def read(self, request: Json) -> Json | None:
        """Read the recorded answer to a request, whatever the mode; None where there is none.

        Raises:
            StoreError: the entry is damaged or of another schema.
        """
        key = self.key(request)
        path = self._path(key)
        try:
            data = path.read_bytes()
        except FileNotFoundError:
            return None
        answer = check_entry(path, data, self._kind, key)["answer"]
        if self._seen is not None:
            self._seen(path)
        return answer

    def holds(self, key: str) -> bool:
        """Say whether there is an entry of a key, sound or not."""
        return self._path(key).exists()

    def write(self, request: Json, answer: Json) -> None:
        """Record an answer, durably and in one step; an entry of the same key is replaced."""
        place, entry = sealed_entry(self._kind, request, answer)
        text = readable(entry)
        write_durably(self._folder.parent / place, text)

    def entries(self) -> Iterator[Json]:
        """Give every entry, checked, in the order of their keys.

        Raises:
            StoreError: an entry is damaged or of another schema.
        """
        for path in sorted(self._folder.glob("*/*.json")):
            yield check_entry(path, path.read_bytes(), self._kind, path.stem)

    def nearest(self, request: Json, most: int | None = None) -> tuple[Json, list[Field]] | None:
        """Find the recording that differs from a request in the fewest fields, but in at least one.

        Args:
            request: what was asked.
            most: how many recordings to compare, in the order of their keys; None for all.

        Returns:
            The entry and the fields, or None where there is no other sound entry.
        """
        compared = ((entry, differences(entry["request"], request)) for entry in self._sound(most))
        return min((pair for pair in compared if pair[1]), key=lambda pair: len(pair[1]), default=None)

    def _sound(self, most: int | None) -> Iterator[Json]:
        """Give entries to compare with; a damaged one is not what a miss is about."""
        for path in itertools.islice(sorted(self._folder.glob("*/*.json")), most):
            with contextlib.suppress(StoreError, OSError):
                yield check_entry(path, path.read_bytes(), self._kind, path.stem)

    def _path(self, key: str) -> Path:
        return self._folder / key[:2] / f"{key}.json"

    def _explain_miss(self, request: Json) -> str:
        """Say which recording comes nearest and in which field it differs first."""
        missed = f"no recorded answer for {self._kind} request {self.key(request)[:12]} in {self._folder}"
        found = self.nearest(request, _COMPARED)
        if found is None:
            return f"{missed}; {EMPTY}"
        nearest, fields = found
        return (
            f"{missed}; the nearest recording is {nearest['key'][:12]}, whose field {shown(fields[0])!r} differs; "
            f"{OTHERWISE}"
        )


def sealed_entry(kind: str, request: Json, answer: Json) -> tuple[str, dict[str, Json]]:
    """Give where an entry stands below the root of the stores, e.g. `probes/0a/0a1b....json`, and all that it holds.

    Raises:
        ValueError: a number is NaN or infinite.
    """
    key = _key(kind, request)
    entry = {"schema": SCHEMA, "kind": kind, "key": key, "request": request, "answer": answer}
    return f"{kind}/{key[:2]}/{key}.json", {**entry, "checksum": content_hash(entry)}


def sweep_stores(root: Path) -> None:
    """Remove what killed writers left in the stores, and in the records of batches, below `root`."""
    for kind in (*KINDS, "batches"):
        sweep(root / kind)


def _key(kind: str, request: Json) -> str:
    return content_hash({"schema": SCHEMA, "kind": kind, "request": request})


def check_entry(path: Path, data: bytes, kind: str, key: str) -> dict[str, Json]:
    """Parse an entry and hold it against its checksum, its place and its question.

    Args:
        path: where it stands, for messages.
        data: what stands there.
        kind: the kind of the store.
        key: what the file's name says.

    Raises:
        StoreError: it is damaged, of another schema, or answers another question than its key stands for.
    """
    remedy = "restore the file from a copy, or delete it so that it is computed again"
    try:
        entry: dict[str, Json] = json.loads(data)
        checksum = entry.pop("checksum")
        sound = content_hash(entry) == checksum and entry.get("key") == key
    except (ValueError, KeyError, AttributeError, TypeError, RecursionError) as error:
        raise StoreError(f"{path} is not a store entry ({type(error).__name__}: {error}); {remedy}") from error
    if entry.get("schema") != SCHEMA:
        raise StoreError(f"{path} has schema {entry.get('schema')!r}; this version reads {SCHEMA}; {remedy}")
    if not sound:
        raise StoreError(f"{path} does not match its checksum; {remedy}")
    missing = sorted({"kind", "request", "answer"} - entry.keys())
    if missing:
        raise StoreError(f"{path} has no {' and no '.join(missing)}; {remedy}")
    if entry["kind"] != kind or _key(kind, entry["request"]) != key:
        raise StoreError(f"{path} holds another question than its name stands for; {remedy}")
    return entry
