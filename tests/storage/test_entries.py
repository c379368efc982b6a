"""Promise: store entries come back from one packed file as they were; one of anybody's is read a line at a time."""

import json
import lzma
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from refusals import refused

from tacevo.errors import StoreError
from tacevo.storage.canonical import canonical
from tacevo.storage.entries import FREE_BYTES, MOST_ENTRIES, ReadBudget, pack, unpack
from tacevo.storage.store import Entry, Store, read_entry

LINES: list[Any] = [
    {"kind": kind, "request": {"of": number}, "answer": {"value": number / 3, "text": "ü\n"}}
    for kind in ("completions", "probes")
    for number in range(3)
]

ENTRIES = [Entry(**line) for line in LINES]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Return where a file is written."""
    return tmp_path / "x.xz"


def packed_as(lines: Sequence[Any], path: Path) -> None:
    """Write lines, whatever they are, as a packed file."""
    write = partial(json.dumps, sort_keys=True, separators=(",", ":"), ensure_ascii=False)  # as `canonical`, and NaN
    path.write_bytes(lzma.compress("".join(f"{write(line)}\n" for line in lines).encode()))


def unpacked(path: Path) -> list[Entry]:
    """Read all entries."""
    return list(unpack(path, ReadBudget(path, path.stat().st_size)))


def test_entries_come_back(file: Path) -> None:
    """As a store has them."""
    for entry in ENTRIES:
        Store(file.parent, entry.kind).write(entry.request, entry.answer)
    file.write_bytes(pack(map(read_entry, file.parent.rglob("*.json"))))
    assert unpacked(file) == ENTRIES


def test_order_of_entries_and_of_their_fields_enters_nothing() -> None:
    """Equal entries give equal bytes."""
    others = [Entry(**{**line, "answer": dict(reversed(line["answer"].items()))}) for line in reversed(LINES)]
    assert pack(ENTRIES) == pack(others)


def test_file_that_ends_early_is_refused(file: Path) -> None:
    """Wherever it does."""
    data = pack(ENTRIES)
    for length in range(len(data)):
        file.write_bytes(data[:length])
        with pytest.raises(StoreError):
            unpacked(file)


def test_bytes_behind_the_end_are_refused(file: Path) -> None:
    """Nothing hides there."""
    file.write_bytes(pack(ENTRIES) + b"more")
    with refused(StoreError, expected="nothing after its end"):
        unpacked(file)


@pytest.mark.parametrize("content", [bytes(5 * FREE_BYTES), b"[" * 100_000 + b"\n", b'"' + bytes(2**24) + b'"\n'])
def test_bomb_is_stopped_while_it_unpacks(content: bytes, file: Path) -> None:
    """Neither one endless line nor endless nesting is kept in memory."""
    file.write_bytes(lzma.compress(b'{"schema":1,"entries":1}\n' + content))
    with pytest.raises(StoreError):
        unpacked(file)


def test_many_small_entries_are_counted_as_the_disk_does(file: Path) -> None:
    """A file of nothing but tiny entries stays below the limit, too."""
    lines: list[Any] = [{"kind": "probes", "request": number, "answer": 0} for number in range(5000)]
    packed_as([{"schema": 1, "entries": len(lines)}, *sorted(lines, key=canonical)], file)
    with refused(StoreError, expected="unpacks to at most"):
        unpacked(file)


def test_window_that_takes_much_memory_is_refused(file: Path) -> None:
    """A header may ask for gigabytes of it."""
    filters = [{"id": lzma.FILTER_LZMA2, "preset": 0, "dict_size": 256 * 1024**2}]
    file.write_bytes(lzma.compress(b"{}\n", filters=filters))
    with refused(StoreError, got="Memory usage limit"):
        unpacked(file)


HEADER: Any = {"schema": 1, "entries": 1}


@pytest.mark.parametrize(
    "line",
    [
        {"kind": "../../evil", "request": 1, "answer": 2},
        {"kind": ["probes"], "request": 1, "answer": 2},
        {"kind": "probes", "request": 1},
        {"kind": "probes", "request": 1, "answer": 2, "checksum": 3},
        {"kind": "probes", "request": float("nan"), "answer": 2},
        [],
        "probes",
        None,
    ],
)
def test_line_that_is_not_an_entry_is_refused(line: Any, file: Path) -> None:
    """With its number; a kind is a name of ours, never a path."""
    packed_as([HEADER, line], file)
    with refused(StoreError, place="line 2"):
        unpacked(file)


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ([], "JSON"),
        ([LINES[0]], "a value"),
        ([{"schema": 2, "entries": 0}], "1"),
        ([{"schema": 1, "entries": MOST_ENTRIES + 1}], f"at most {MOST_ENTRIES}"),
        ([{"schema": 1, "entries": 2}, LINES[0]], "as many entries as the first line says"),
        ([{"schema": 1, "entries": 1}, *LINES[:2]], "as many entries as the first line says"),
        ([{"schema": 1, "entries": 2}, LINES[0], {**LINES[0], "answer": "other"}], "as many entries as"),
    ],
)
def test_header_must_fit(lines: list[Any], expected: str, file: Path) -> None:
    """A layout of another version is not guessed at; entries that were lost, or come twice, are noticed."""
    packed_as(lines, file)
    with refused(StoreError, expected=expected):
        unpacked(file)


HONEST = [canonical({"schema": 1, "entries": len(LINES)}), *map(canonical, LINES)]


@pytest.mark.parametrize(
    ("line", "old", "new"),
    [
        (0, '"entries"', '"entries":0,"entries"'),
        (0, ":", ": "),
        (1, '{"answer"', '{"answer":{"value":9},"answer"'),
        (1, '"kind"', '"kind":"probes","kind"'),
        (1, '"kind"', '"k\\u0069nd":"probes","kind"'),
        (1, '"value":0.0', '"value":9.0,"value":0.0'),
        (1, ":0.0", ":0.0e0"),
        (1, ":0.0", ":0.00"),
        (1, "ü", "\\u00fc"),
        (1, ",", ", "),
        (1, "}", " }"),
        (1, "}", "}\r"),
        (1, '"request":{"of":0}}', '"request":{"of":0} }'),
    ],
)
def test_text_that_is_not_written_of_an_entry_is_refused(line: int, old: str, new: str, file: Path) -> None:
    """A second key of a name, spaces, another spelling of a number or a letter: what no store ever held."""
    file.write_bytes(lzma.compress("".join(f"{text}\n" for text in HONEST).encode()))
    assert unpacked(file) == ENTRIES
    lines = [text.replace(old, new, 1) if place == line else text for place, text in enumerate(HONEST)]
    assert lines != HONEST
    file.write_bytes(lzma.compress("".join(f"{text}\n" for text in lines).encode()))
    with refused(StoreError, place=f"line {line + 1}"):
        unpacked(file)


def test_entries_in_another_order_are_refused(file: Path) -> None:
    """And fields in another order, and an empty line."""
    backwards = json.dumps({"request": LINES[0]["request"], **LINES[0]}, separators=(",", ":"), ensure_ascii=False)
    for lines, place in (
        ([HONEST[0], HONEST[2], HONEST[1], *HONEST[3:]], "line 3"),
        ([HONEST[0], backwards, *HONEST[2:]], "line 2"),
        ([*HONEST, ""], f"line {len(HONEST) + 1}"),
    ):
        file.write_bytes(lzma.compress("".join(f"{text}\n" for text in lines).encode()))
        with refused(StoreError, place=place):
            unpacked(file)


def test_half_a_line_is_refused(file: Path) -> None:
    """Also where it holds a whole entry: whoever wrote it was stopped."""
    file.write_bytes(lzma.compress("\n".join(map(canonical, [{"schema": 1, "entries": 1}, LINES[0]])).encode()))
    with refused(StoreError, got="}", expected="a line feed at the end", remedy="fetch it again"):
        unpacked(file)


def test_canonical_text_of_an_entry_is_what_a_bundle_holds() -> None:
    """The bytes of published runs depend on it."""
    *_, last = lzma.decompress(pack(ENTRIES)).decode().splitlines()
    assert last == canonical(LINES[-1])
