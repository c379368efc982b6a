"""Many store entries as one compressed file: a header, then one JSON line for each, sorted, in one LZMA stream.

Entries of one kind repeat each other's text, so that packed together they take a small part of what they take one by
one. A line holds kind, request and answer; key, place and checksum follow from these. All text follows from entries,
and a reader refuses any other.
"""

import lzma
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from annotated_types import Ge, Le

from tacevo.errors import StoreError
from tacevo.records import Record
from tacevo.storage.canonical import canonical
from tacevo.storage.members import Member, as_tree
from tacevo.storage.store import KINDS, Entry, place_of
from tacevo.typed import parse

T = TypeVar("T")

#: Layout of the file.
SCHEMA = 1

#: Equal text lies near where lines are sorted; a larger window takes memory and saves little.
_FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 6}]

#: The memory that unpacking may take, in bytes; the window above takes 8 MiB of it.
_MEMORY = 64 * 1024**2

#: The longest line, bytes: a probe's answer has at most 2 MiB, and no other entry comes near that.
LONGEST_LINE = 8 * 1024**2

#: The most entries: a run of 10,000 candidates has some 40,000.
MOST_ENTRIES = 250_000

#: The bytes that an entry counts beside its text: as many as the file that an import makes of it takes on disk.
_BLOCK = 4096

#: The bytes that all that is unpacked may take: about four times a run of 10,000 candidates.
MOST_BYTES = 2 * 1024**3

#: The size to which a file may unpack, as a multiple of its own. A run of 1,000 candidates comes to 12, one of 86 to
#: 14; deflate could make a thousand of it, LZMA many thousands.
MOST_RATIO = 200

#: A small file may unpack to this much whatever its ratio, which tells little of a few repeated lines.
FREE_BYTES = 16 * 1024**2

#: The kind of an entry that holds a candidate's file, in a sweep's bundle. Thousands of small members would take longer
#: to list than to hold; beside the answers that they came from, these take almost nothing. A store has none.
CANDIDATES = "candidates"

_KINDS = (*KINDS, CANDIDATES)

#: Bytes that are unpacked at a time.
CHUNK = 1024**2


@dataclass(frozen=True, slots=True, kw_only=True)
class _Header(Record):
    """The first line."""

    schema: Literal[1]
    entries: Annotated[int, Ge(0), Le(MOST_ENTRIES)]


class ReadBudget:
    """Counts the bytes that a file of a size unpacks to, and stops at a limit."""

    def __init__(self, source: Path, size: int) -> None:
        self._source = source
        self._left = min(MOST_BYTES, max(FREE_BYTES, MOST_RATIO * size))

    def spend(self, count: int, name: str) -> None:
        """Count bytes that a member of the file was unpacked to.

        Raises:
            StoreError: with these, the limit is passed.
        """
        self._left -= count
        if self._left < 0:
            raise StoreError(
                f"more, in {name}",
                place=str(self._source),
                expected=f"a file that unpacks to at most {MOST_RATIO} times its size and {MOST_BYTES} bytes",
                remedy="do not trust it",
            )


def pack(entries: Iterable[Entry]) -> bytes:
    """Write store entries as one file; the order in which they come does not matter."""
    lines = sorted((entry.kind, _line(entry)) for entry in entries)
    text = "\n".join([_header(len(lines)), *(line for _, line in lines)]) + "\n"
    return lzma.compress(text.encode(), format=lzma.FORMAT_XZ, check=lzma.CHECK_CRC64, filters=_FILTERS)


def _header(count: int) -> str:
    return canonical({"schema": SCHEMA, "entries": count})


def _line(entry: Entry) -> str:
    return canonical({"kind": entry.kind, "request": entry.request, "answer": entry.answer})


def unpack(source: Path, budget: ReadBudget) -> Iterator[Entry]:
    """Read the entries of a file that anybody may have written, one at a time.

    Raises:
        StoreError: the file is damaged, a line is not an entry, or not the text that `pack` writes of it in its place;
            the message names it.
    """
    return (entry for entry, _, _ in _checked(source, budget))


def unpack_in_memory(source: Path, budget: ReadBudget) -> tuple[Member, tuple[Entry, ...]]:
    """Read the entries of a bundle; return its stores, and the entries that hold candidates' files.

    A file of these stores is the line of its entry, which takes a tenth of the memory of what is read from it.

    Raises:
        StoreError: as `unpack`.
    """
    texts, candidates = {}, []
    for entry, key, line in _checked(source, budget):
        if entry.kind == CANDIDATES:
            candidates.append(entry)
        else:
            texts[place_of(entry.kind, key)] = line
    return Member(str(source), as_tree(texts), between=", "), tuple(candidates)


def _checked(source: Path, budget: ReadBudget) -> Iterator[tuple[Entry, str, bytes]]:
    """Read entries as `unpack`, each with its key and its line."""
    lines = _lines(source, budget)
    place, expected = f"{source}, line 1", "as many entries as the first line says"
    header = next(lines, b"")
    count = parse(_Header, header, place=place, error=StoreError).entries
    _check_text(header, _header, count, place)
    number, keys, last = 0, set[str](), ("", b"")
    for number, line in enumerate(lines, start=1):
        budget.spend(_BLOCK, source.name)
        place = f"{source}, line {number + 1}"
        entry = parse(Entry, line, place=place, error=StoreError)
        if entry.kind not in _KINDS:
            raise StoreError(repr(entry.kind), place=f"{place}, kind", expected=f"one of {', '.join(_KINDS)}")
        _check_text(line, _line, entry, place)
        key = entry.key
        if key in keys or number > count:
            got = f"the key {key[:12]} a second time" if key in keys else f"entry {number} of {count}"
            raise StoreError(got, place=place, expected=expected)
        keys.add(key)
        if (entry.kind, line) < last:
            raise StoreError("another order", place=place, expected="entries in the order of their kinds and texts")
        last = (entry.kind, line)
        yield entry, key, line
    if number != count:
        raise StoreError(f"{number} of {count}", place=str(source), expected=expected)


def _check_text(line: bytes, text_of: Callable[[T], str], content: T, place: str) -> None:
    """Compare a line with the text that `pack` writes of what was read from it: another one was never recorded."""
    try:
        is_ours = line == text_of(content).encode()
    except ValueError as error:  # NaN, or a number that is no float
        raise StoreError(str(error), place=place, expected="JSON of finite numbers") from error
    if not is_ours:
        raise StoreError("the same content in another text", place=place, expected="the text that is written of it")


def _lines(source: Path, budget: ReadBudget) -> Iterator[bytes]:
    """Yield the lines as they are unpacked, within the budget."""
    rest = bytearray()
    for chunk in _chunks(source):
        budget.spend(len(chunk), source.name)
        *whole, tail = chunk.split(b"\n")
        for part in whole:
            yield bytes(rest + part)
            rest.clear()
        rest += tail
        if len(rest) > LONGEST_LINE:
            got = f"one of at least {len(rest)}"
            raise StoreError(got, place=str(source), expected=f"lines of at most {LONGEST_LINE} bytes")
    if rest:
        got = repr(bytes(rest[-20:]))
        raise StoreError(got, place=str(source), expected="a line feed at the end", remedy="fetch it again")


def _chunks(source: Path) -> Iterator[bytes]:
    """Unpack a file a piece at a time, whatever size it claims."""
    unpacker = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_MEMORY)
    data = source.read_bytes()
    try:
        while not unpacker.eof:
            chunk = unpacker.decompress(data, CHUNK)
            if not chunk and unpacker.needs_input:
                raise EOFError("it ends too early")
            data = b""
            yield chunk
    except (lzma.LZMAError, EOFError) as error:
        expected = "store entries as `tacevo cache export` and `tacevo publish` write them"
        raise StoreError(str(error), place=str(source), expected=expected, remedy="fetch it again") from error
    if unpacker.unused_data:
        got = f"{len(unpacker.unused_data)} bytes"
        raise StoreError(got, place=str(source), expected="nothing after its end", remedy="fetch it again")
