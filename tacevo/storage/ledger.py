"""The ledger: what was decided, one JSON line at a time, each sealed with the hash of the line before.

What it promises: the last hash, the digest, stands for every decision; a line, once committed, survives a crash; what
is computed again is compared with its ledger line by line. Time stamps, durations, host names and paths never enter it.
"""

import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Generic, Self, TypeVar

from tacevo.errors import DivergenceError, RunError
from tacevo.records import Json, written
from tacevo.storage.canonical import canonical, content_hash, differences, shown, value_at
from tacevo.typed import UncheckedJson, convert, parse

#: A record of one line.
L_co = TypeVar("L_co", covariant=True)

#: Returns the class of a line that is read as JSON; None where there is none.
KindOf = Callable[[Mapping[str, Json]], type[L_co] | None]

#: The hash before the first line.
GENESIS = "0" * 64

#: What a line of a candidate, or of a training of it, says of which it is.
_CANDIDATE = re.compile(rb'"id":"(g[0-9]{1,9}s[0-9]{1,9})"')

_RESTORE = "restore the file, or start in a new run.dir"


@dataclass(frozen=True, slots=True)
class Sealed(Generic[L_co]):
    """The lines of a ledger whose chain was checked."""

    lines: tuple[L_co, ...] = ()
    #: The hash of each line.
    hashes: tuple[str, ...] = ()

    @property
    def digest(self) -> str:
        """The last hash, which stands for all lines."""
        return self.hashes[-1] if self.hashes else GENESIS


_NO_LINES: Sealed[object] = Sealed()


class Ledger:
    """A ledger, open for committing.

    Committing where a line already stands compares instead of appending; so the same loop writes a run, resumes a
    killed one and checks a finished one. Without a file, lines are compared and counted only.

    Args:
        recorded: the lines that stand there.
        file: where further lines are written.
    """

    def __init__(self, recorded: Sealed[object] = _NO_LINES, file: FileIO | None = None) -> None:
        self._recorded = recorded
        self._file = file
        #: The number of lines committed in this session.
        self.committed = 0
        self.digest = GENESIS

    @classmethod
    def open(cls, path: Path, kind_of: KindOf[object]) -> Self:
        """Open the ledger in a file, new or begun.

        Raises:
            RunError: the file is damaged before its last line.
        """
        recorded = read_lines(path, kind_of)
        length = len(_whole(path))
        file = path.open("ab", buffering=0)  # no rest of a failed line waits to be written at the end
        file.truncate(length)  # a line torn by a crash was never committed
        return cls(recorded, file)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file; every committed line is on disk already."""
        if self._file is not None:
            self._file.close()

    @property
    def recorded(self) -> int:
        """The number of lines that stood here before."""
        return len(self._recorded.lines)

    @property
    def recorded_digest(self) -> str:
        """The hash of the last line that stood here before; `GENESIS` where none did."""
        return self._recorded.hashes[-1] if self._recorded.hashes else GENESIS

    @property
    def has_grown(self) -> bool:
        """Whether a line was appended in this session."""
        return self.committed > self.recorded

    def commit(self, line: object) -> None:
        """Append a line, a record, or compare it with the one that stands in its place.

        Raises:
            DivergenceError: the recorded line differs; the message names generation, slot and field.
            RunError: the disk is full or fails; the lines before this one are safe.
            ValueError: a number is NaN or infinite.
        """
        sealed, digest = seal(written(line), self.digest)
        if self.committed < self.recorded:
            if self._recorded.hashes[self.committed] != digest:
                recorded = self._recorded.lines[self.committed]
                field, (was, now) = first_difference(recorded, line)
                raise DivergenceError(now, place=f"{place_of(recorded)}, {field}", expected=f"{was} as recorded")
        elif self._file is not None:
            _append(self._file, f"{canonical(sealed)}\n".encode())
        self.committed += 1
        self.digest = digest


def seal(entry: Mapping[str, Json], previous: str) -> tuple[dict[str, Json], str]:
    """Link a line's JSON to the line before it; return it with its own hash, and that hash."""
    linked = {**entry, "previous": previous}
    digest = content_hash(linked)
    return {**linked, "hash": digest}, digest


def sealed_text(lines: Sequence[object]) -> tuple[str, str]:
    """Return the text of a whole ledger, and its digest."""
    texts, digest = [], GENESIS
    for line in lines:
        sealed, digest = seal(written(line), digest)
        texts.append(f"{canonical(sealed)}\n")
    return "".join(texts), digest


def read_lines(
    path: Path,
    kind_of: KindOf[L_co],
    name_line: Callable[[Sequence[L_co]], str] = lambda lines: f"line {len(lines) + 1}",
) -> Sealed[L_co]:
    """Read a ledger as records and check its chain; a last line torn by a crash is left out, and so is a missing file.

    Args:
        path: the file.
        kind_of: returns the class of a line, e.g. `tacevo.evolution.run_files.line_kind`.
        name_line: names the line behind the given ones, for messages.

    Raises:
        RunError: a line was damaged or edited, or is not a line of such a ledger; the message names it.
    """
    lines: list[L_co] = []
    hashes = [GENESIS]
    for text in _whole(path).splitlines():
        place = f"{path}, {name_line(lines)}{_of_candidate(text)}"
        line, previous, own = read_line(text, kind_of, place)
        if previous != hashes[-1] or own != seal(written(line), previous)[1]:
            raise RunError(
                "another hash: this line or the one before it was edited",
                place=place,
                expected="a line that matches its hash",
                remedy=_RESTORE,
            )
        lines.append(line)
        hashes.append(own)
    return Sealed(tuple(lines), tuple(hashes[1:]))


def broken_line(data: bytes) -> str:
    """Name the first line of a ledger that does not match its own hash, with its candidate; empty where all match."""
    for number, text in enumerate(data.splitlines(), start=1):
        if not text:  # more than a ledger has, but no line of it
            continue
        try:
            entry = json.loads(text)
            own, previous = entry.pop("hash"), entry.pop("previous")
            is_whole = own == seal(entry, previous)[1]
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            is_whole = False
        if not is_whole:
            return f"line {number}{_of_candidate(text)}"
    return ""


def _of_candidate(text: bytes) -> str:
    """Write the candidate that a line is of, as it says before it is read; empty where it names none."""
    found = _CANDIDATE.search(text)
    return "" if found is None else f" ({found[1].decode()})"


def read_line(text: bytes, kind_of: KindOf[L_co], place: str) -> tuple[L_co, str, str]:
    """Read one line as a record, with the previous line's hash and its own, which are not checked.

    Raises:
        RunError: it is not a line of such a ledger.
    """
    entry = parse(dict[str, UncheckedJson], text, place=place, error=RunError, remedy=_RESTORE)
    try:
        kind = kind_of(entry)
    except RunError as error:
        error.place = place
        raise
    if kind is None:
        raise RunError(_brief(entry), place=place, expected="a line of a known kind", remedy=_RESTORE)
    previous, own = (str(entry.pop(name, None)) for name in ("previous", "hash"))
    return convert(kind, entry, place=place, error=RunError, remedy=_RESTORE), previous, own


def _whole(path: Path) -> bytes:
    """Read the whole lines of a ledger."""
    data = path.read_bytes() if path.exists() else b""
    return data[: data.rfind(b"\n") + 1]


def _append(file: FileIO, data: bytes) -> None:
    """Write a line to its end, and wait until it is on the disk."""
    try:
        while data:
            data = data[file.write(data) :]  # a disk that fills up takes a part of it first
        os.fsync(file.fileno())
    except OSError as error:
        raise RunError(
            f"{error.strerror}, while a line was written; the lines before it are safe",
            place=str(file.name),
            remedy="make room, and run the same command again",
        ) from error


def first_difference(one: object, other: object) -> tuple[str, tuple[str, str]]:
    """Return the first field in which two lines differ, with both values, shortened for a person."""
    lines = written(one), written(other)
    field = differences(*lines)[0]
    was, now = (_brief(value_at(line, field)) for line in lines)
    return shown(field), (was, now)


def place_of(line: object) -> str:
    """Return where a line stands, in the words of a run or of a study."""
    match written(line):
        case {"network": network, "seed": seed}:
            return f"{network}, seed {seed}"
        case {"generation": generation, "slot": slot, "id": name}:
            return f"{name} (generation {generation}, slot {slot})"
        case {"generation": generation, "slot": slot}:
            return f"generation {generation}, slot {slot}"
        case {"generation": generation}:
            return f"generation {generation}"
        case header:
            return f"the {header['kind']}'s header"


def _brief(value: Json, limit: int = 200) -> str:
    text = json.dumps(value, sort_keys=True)
    return text if len(text) <= limit else text[: limit - 3] + "..."
