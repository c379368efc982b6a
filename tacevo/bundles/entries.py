"""Many store entries as one compressed file: a header, then one JSON line for each, sorted, in one LZMA stream.

Entries of one kind repeat each other's text, so that packed together they take a small part of what they take one by
one. A line holds kind, request and answer; key, place and checksum follow from these and are made anew.
"""

import json
import lzma
from collections.abc import Iterable, Iterator
from pathlib import Path

from tacevo.bundles.zipfiles import CHUNK, Budget
from tacevo.errors import BundleError
from tacevo.records import Json
from tacevo.storage.canonical import canonical
from tacevo.storage.store import KINDS, sealed_entry

#: Layout of the file.
SCHEMA = 1

#: Equal text lies near where lines are sorted; a larger window takes memory and saves little.
_FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 6}]

#: What unpacking may take, bytes; the window above takes 8 MiB of it.
_MEMORY = 64 * 1024**2

#: The longest line, bytes: a probe's answer has at most 2 MiB, and no other entry comes near that.
LONGEST_LINE = 8 * 1024**2

#: The most entries: a run of 10,000 candidates has some 40,000.
MOST_ENTRIES = 250_000

#: What a file takes on the disk at least, bytes.
_BLOCK = 4096


def pack(entries: Iterable[Json]) -> bytes:
    """Write store entries as one file; the order in which they come does not matter."""
    lines = sorted(
        (entry["kind"], canonical({name: entry[name] for name in ("request", "answer", "kind")})) for entry in entries
    )
    header = canonical({"schema": SCHEMA, "entries": len(lines)})
    text = "\n".join([header, *(line for _, line in lines)]) + "\n"
    return lzma.compress(text.encode(), format=lzma.FORMAT_XZ, check=lzma.CHECK_CRC64, filters=_FILTERS)


def unpack(source: Path, root: Path, budget: Budget) -> int:
    """Write the entries of a file into new stores; they need not survive a crash.

    Args:
        source: what `pack` wrote.
        root: the folder of the stores.
        budget: what may be unpacked.

    Returns:
        The number of entries.

    Raises:
        BundleError: the file was damaged, or a line is no entry; the message names it.
    """
    lines = _lines(source, budget)
    expected = _count(source, next(lines, b""))
    if expected > MOST_ENTRIES:
        raise BundleError(f"{source} names {expected} entries; {MOST_ENTRIES} is the most that one may have")
    count = 0
    for count, line in enumerate(lines, start=1):
        if count > expected:
            raise BundleError(f"{source} holds more than the {expected} entries of its first line")
        place, text = _entry(f"{source}, line {count + 1}", line)
        budget.spend(_BLOCK, f"{source.name!r}")
        path = root / place
        if path.exists():
            raise BundleError(f"{source}, line {count + 1} holds an entry that an earlier line holds, too")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    if count != expected:
        raise BundleError(f"{source} holds {count} entries; its first line says {expected}")
    return count


def _lines(source: Path, budget: Budget) -> Iterator[bytes]:
    """Give the lines as they are unpacked, within the budget."""
    rest = bytearray()
    for chunk in _chunks(source):
        budget.spend(len(chunk), f"{source.name!r}")
        *whole, tail = chunk.split(b"\n")
        for part in whole:
            yield bytes(rest + part)
            rest.clear()
        rest += tail
        if len(rest) > LONGEST_LINE:
            raise BundleError(f"{source}: a line is longer than {LONGEST_LINE} bytes")
    if rest:
        raise BundleError(f"{source} ends within a line")


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
        raise BundleError(f"{source} is damaged: {error}") from error
    if unpacker.unused_data:
        raise BundleError(f"{source}: something stands behind its end")


def _count(source: Path, line: bytes) -> int:
    """Read the header; return the number of entries."""
    try:
        header = json.loads(line)
        schema, entries = header["schema"], int(header["entries"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise BundleError(f"{source} does not begin with a header: {type(error).__name__}: {error}") from error
    if schema != SCHEMA:
        raise BundleError(f"{source} has schema {schema!r}; this version reads {SCHEMA}")
    return entries


def _entry(place: str, line: bytes) -> tuple[str, str]:
    """Parse a line; give the entry's place in the stores and its text."""
    try:
        entry = json.loads(line)
        known = entry.keys() == {"kind", "request", "answer"} and entry["kind"] in KINDS
        if not known:
            raise KeyError("an entry has a known kind, a request and an answer")
        name, sealed = sealed_entry(entry["kind"], entry["request"], entry["answer"])
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise BundleError(f"{place} is no entry of a store: {type(error).__name__}: {error}") from error
    return name, canonical(sealed)
