"""The ledger: what a search decided, one JSON line at a time, each sealed with the hash of the line before.

What it promises: the last hash, the digest, stands for every decision of the run; a line, once committed,
survives a crash; a run that is computed again is held against its ledger line by line. Time stamps, durations,
host names and paths never enter it.
"""

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Generic, Self, TypeVar

from tacevo.errors import DivergenceError, RunError
from tacevo.records import Json, written
from tacevo.storage.canonical import canonical, content_hash, differences, shown, value_at
from tacevo.typed import convert

#: A record of one line.
L = TypeVar("L")

#: Returns the class of a line that is read as JSON; None where there is none.
KindOf = Callable[[Mapping[str, Json]], type[L] | None]

#: The hash before the first line.
GENESIS = "0" * 64

_RESTORE = "restore the file, or start in a new run.dir"


def seal(entry: dict[str, Json], previous: str) -> dict[str, Json]:
    """Link an entry to the line before it and add its own hash."""
    linked = {**entry, "previous": previous}
    return {**linked, "hash": content_hash(linked)}


def is_sealed(line: dict[str, Json], previous: str) -> bool:
    """Tell whether a line is as it was sealed, behind the line of that hash."""
    return line == seal(unsealed(line), previous)


class Ledger:
    """The ledger of one run, open for committing.

    Committing where a line already stands compares instead of appending; so the same loop writes a run, takes
    up a killed one and checks a finished one.

    Args:
        path: the file, `ledger.jsonl`; None keeps the lines in memory only.
        recorded: lines to be held against, for a ledger in memory.

    Raises:
        RunError: the file is damaged before its last line.
    """

    def __init__(self, path: Path | None, recorded: tuple[dict[str, Json], ...] = ()) -> None:
        self._recorded = recorded
        self._file: FileIO | None = None
        self._count = 0
        self.digest = GENESIS
        if path is not None:
            self._recorded, length = _read(path)
            self._file = path.open("ab", buffering=0)  # no rest of a failed line waits to be written at the end
            self._file.truncate(length)  # a line torn by a crash was never committed

    def __enter__(self) -> Self:
        """Give the open ledger."""
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
        return len(self._recorded)

    @property
    def committed(self) -> int:
        """The number of lines committed in this session."""
        return self._count

    def commit(self, entry: dict[str, Json]) -> dict[str, Json]:
        """Append an entry, or hold it against the line that stands in its place.

        Returns:
            The entry with `previous` and `hash`.

        Raises:
            DivergenceError: the recorded line differs; the message names generation, slot and field.
            RunError: the disk is full or fails; the lines before this one are safe.
            ValueError: a number is NaN or infinite.
        """
        line = seal(entry, self.digest)
        if self._count < len(self._recorded):
            _compare(self._recorded[self._count], line)
        elif self._file is not None:
            _append(self._file, f"{canonical(line)}\n".encode())
        self._count += 1
        self.digest = line["hash"]
        return line


def read_ledger(path: Path) -> tuple[dict[str, Json], ...]:
    """Read a ledger and check its chain; a last line torn by a crash is left out.

    Raises:
        RunError: the file is missing, or a line was damaged or edited.
    """
    if not path.exists():
        raise RunError(f"{path} is missing; give the folder of a run, as `tacevo search` printed it")
    return _read(path)[0]


@dataclass(frozen=True, slots=True)
class Sealed(Generic[L]):
    """The lines of a ledger whose chain was checked."""

    lines: tuple[L, ...] = ()
    #: Of each line.
    hashes: tuple[str, ...] = ()

    @property
    def digest(self) -> str:
        """The last hash, which stands for all lines."""
        return self.hashes[-1] if self.hashes else GENESIS


def read_lines(path: Path, kind_of: KindOf[L], *, name_line: Callable[[list[L]], str] | None = None) -> Sealed[L]:
    """Read a ledger as records and check its chain; a last line torn by a crash is left out, and so is a missing file.

    Args:
        path: the file.
        kind_of: returns the class of a line, e.g. `tacevo.search.lines.line_kind`.
        name_line: names the line that follows the given ones, for messages; None for its number.

    Raises:
        RunError: a line was damaged or edited, or is not a line of such a ledger; the message names it.
    """
    data = path.read_bytes() if path.exists() else b""
    lines: list[L] = []
    hashes = [GENESIS]
    for number, text in enumerate(data[: data.rfind(b"\n") + 1].splitlines(), 1):
        place = f"{path}, {f'line {number}' if name_line is None else name_line(lines)}"
        line, previous, own = read_line(text, kind_of, place)
        if previous != hashes[-1] or own != _hash(line, previous):
            raise RunError(
                "one that was edited, or that follows an edited one",
                place=place,
                expected="a line that matches its hash",
                remedy=_RESTORE,
            )
        lines.append(line)
        hashes.append(own)
    return Sealed(tuple(lines), tuple(hashes[1:]))


def read_line(text: bytes, kind_of: KindOf[L], place: str) -> tuple[L, str, str]:
    """Read one line as a record, with the previous line's hash and its own, which are not checked.

    Raises:
        RunError: it is not a line of such a ledger.
    """
    try:
        entry = json.loads(text)
        canonical(entry)  # which fails on NaN and infinity, that Python's reader lets through
    except (ValueError, RecursionError) as error:
        raise RunError(str(error), place=place, expected="JSON", remedy=_RESTORE) from error
    kind = kind_of(entry) if isinstance(entry, dict) else None
    if kind is None:
        raise RunError(_brief(entry), place=place, expected="a line of a known kind", remedy=_RESTORE)
    previous, own = (str(entry.pop(name, None)) for name in ("previous", "hash"))
    return convert(kind, entry, place=place, error=RunError, remedy=_RESTORE), previous, own


def _hash(line: L, previous: str) -> str:
    return content_hash({**written(line), "previous": previous})


def _append(file: FileIO, data: bytes) -> None:
    """Write a line to its end, and wait until it is on the disk."""
    try:
        while data:
            data = data[file.write(data) :]  # a disk that fills up takes a part of it first
        os.fsync(file.fileno())
    except OSError as error:
        raise RunError(
            f"{file.name} cannot be written: {error.strerror}; the lines before are safe. Make room, and run the same "
            "command again"
        ) from error


def _read(path: Path) -> tuple[tuple[dict[str, Json], ...], int]:
    """Read the whole lines of a ledger, and how many bytes they take."""
    data = path.read_bytes() if path.exists() else b""
    length = data.rfind(b"\n") + 1
    lines: list[dict[str, Json]] = []
    previous = GENESIS
    for number, text in enumerate(data[:length].splitlines(), 1):
        lines.append(_checked(path, number, text, previous))
        previous = lines[-1]["hash"]
    return tuple(lines), length


def _checked(path: Path, number: int, text: bytes, previous: str) -> dict[str, Json]:
    """Parse one line and hold it against its own hash and its predecessor's."""
    try:
        line: dict[str, Json] = json.loads(text)
        sound = is_sealed(line, previous)
    except (ValueError, AttributeError, RecursionError) as error:
        raise RunError(
            f"{path}, line {number} is not JSON ({error}); restore the file, or start in a new run.dir"
        ) from error
    if not sound:
        raise RunError(
            f"{path}, line {number} does not match its hash: it, or the line before it, was edited; restore the file, "
            "or start in a new run.dir"
        )
    return line


def _compare(recorded: dict[str, Json], line: dict[str, Json]) -> None:
    """Raise on the first field in which a recomputed line differs from the recorded one."""
    if recorded["hash"] == line["hash"]:
        return
    field, (was, now) = first_difference(recorded, line)
    raise DivergenceError(f"{place_of(recorded)}: field {field!r} was recorded as {was} and is now {now}")


def first_difference(one: dict[str, Json], other: dict[str, Json]) -> tuple[str, tuple[str, str]]:
    """Name the first field in which two lines differ, with both values, shortened for a person.

    Args:
        one: a line whose content, the seal left out, is not the other's.
        other: that one.
    """
    lines = unsealed(one), unsealed(other)
    field = differences(*lines)[0]
    was, now = (_brief(value_at(line, field)) for line in lines)
    return shown(field), (was, now)


def place_of(line: dict[str, Json]) -> str:
    """Say where a line stands, in the words of a run or of a study."""
    match line:
        case {"network": network, "seed": seed}:
            return f"{network}, seed {seed}"
        case {"generation": generation, "slot": slot}:
            return f"generation {generation}, slot {slot}"
        case {"generation": generation}:
            return f"generation {generation}"
        case _:
            return f"the {line.get('kind', 'run')}'s header"


def unsealed(line: dict[str, Json]) -> dict[str, Json]:
    """Give what a line says, without the hashes that seal it."""
    return {key: value for key, value in line.items() if key not in {"previous", "hash"}}


def _brief(value: Json, limit: int = 200) -> str:
    text = json.dumps(value, sort_keys=True)
    return text if len(text) <= limit else text[: limit - 3] + "..."
