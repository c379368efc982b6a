"""Promise: store entries come back from one packed file as they were; one of anybody's is read a line at a time."""

import json
import lzma
from collections.abc import Sequence
from pathlib import Path

import pytest

from tacevo.bundles.entries import MOST_ENTRIES, pack, unpack
from tacevo.bundles.zipfiles import FREE_BYTES, Budget
from tacevo.errors import BundleError
from tacevo.records import Json
from tacevo.storage.canonical import canonical
from tacevo.storage.store import Store

ENTRIES: list[Json] = [
    {"kind": kind, "request": {"of": number}, "answer": {"value": number / 3, "text": "ü\n"}}
    for kind in ("probes", "completions")
    for number in range(3)
]


def packed_as(lines: Sequence[Json], path: Path) -> Path:
    """Write lines, whatever they are, as a packed file."""
    path.write_bytes(lzma.compress("".join(f"{json.dumps(line)}\n" for line in lines).encode()))
    return path


def refused(path: Path, words: str) -> None:
    """See that a file is refused."""
    with pytest.raises(BundleError, match=words):
        unpack(path, path.parent / "store", Budget(path, path.stat().st_size))


def test_entries_come_back(tmp_path: Path) -> None:
    """In the place and with all that a store writes, key and checksum too."""
    for entry in ENTRIES:
        Store(tmp_path / "before", entry["kind"]).write(entry["request"], entry["answer"])
    paths = sorted((tmp_path / "before").rglob("*.json"))
    file = tmp_path / "store.jsonl.xz"
    file.write_bytes(pack(json.loads(path.read_bytes()) for path in paths))
    assert unpack(file, tmp_path / "after", Budget(file, 1000)) == len(ENTRIES)
    before = {path.relative_to(tmp_path / "before"): path.read_bytes() for path in paths}
    after = sorted((tmp_path / "after").rglob("*.json"))
    read = {path.relative_to(tmp_path / "after"): json.loads(path.read_bytes()) for path in after}
    assert read == {name: json.loads(content) for name, content in before.items()}


def test_order_of_entries_and_of_their_fields_enters_nothing() -> None:
    """Equal entries give equal bytes."""
    assert pack(ENTRIES) == pack([dict(reversed(entry.items())) for entry in reversed(ENTRIES)])


def test_file_that_ends_early_is_refused(tmp_path: Path) -> None:
    """Wherever it does."""
    data = pack(ENTRIES)
    for length in range(0, len(data), 7):
        path = tmp_path / str(length) / "x.xz"
        path.parent.mkdir()
        path.write_bytes(data[:length])
        refused(path, "is damaged|does not begin with a header|holds . entries|ends within a line")


def test_bytes_behind_the_end_are_refused(tmp_path: Path) -> None:
    """Nothing hides there."""
    (tmp_path / "x.xz").write_bytes(pack(ENTRIES) + b"more")
    refused(tmp_path / "x.xz", "something stands behind its end")


def test_bomb_is_stopped_while_it_unpacks(tmp_path: Path) -> None:
    """Neither one endless line nor many short ones are kept in memory or on the disk."""
    for content in (bytes(5 * FREE_BYTES), b"\n" * 5 * FREE_BYTES):
        (tmp_path / "x.xz").write_bytes(lzma.compress(b'{"schema":1,"entries":1}\n' + content))
        refused(
            tmp_path / "x.xz", "unpacks to more than a published run may|is no entry of a store|a line is longer than"
        )


def test_window_that_takes_much_memory_is_refused(tmp_path: Path) -> None:
    """A header may ask for gigabytes of it."""
    filters = [{"id": lzma.FILTER_LZMA2, "preset": 0, "dict_size": 256 * 1024**2}]
    (tmp_path / "x.xz").write_bytes(lzma.compress(b"{}\n", filters=filters))
    refused(tmp_path / "x.xz", "is damaged: Memory usage limit")


HEADER: Json = {"schema": 1, "entries": 1}


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
def test_line_that_is_no_entry_is_refused(line: Json, tmp_path: Path) -> None:
    """With its number; a kind is a name of ours, never a path."""
    refused(packed_as([HEADER, line], tmp_path / "x.xz"), "line 2 is no entry of a store")
    assert not (tmp_path / "store").exists()


def test_endless_nesting_is_refused(tmp_path: Path) -> None:
    """JSON that is deeper than the parser goes is a bad line like any other."""
    (tmp_path / "x.xz").write_bytes(lzma.compress(f"{canonical(HEADER)}\n{'[' * 100_000}\n".encode()))
    refused(tmp_path / "x.xz", "line 2 is no entry of a store: RecursionError")


def test_entry_that_comes_twice_is_refused(tmp_path: Path) -> None:
    """Two answers to one question: neither is believed."""
    lines = [{"schema": 1, "entries": 2}, ENTRIES[0], {**ENTRIES[0], "answer": "other"}]
    refused(packed_as(lines, tmp_path / "x.xz"), "line 3 holds an entry that an earlier line holds")


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ([], "does not begin with a header"),
        ([{"schema": 2, "entries": 0}], "has schema 2; this version reads 1"),
        ([{"schema": 1, "entries": 2}, ENTRIES[0]], "holds 1 entries; its first line says 2"),
        ([{"schema": 1, "entries": 1}, *ENTRIES[:2]], "holds more than the 1 entries of its first line"),
        ([{"schema": 1, "entries": MOST_ENTRIES + 1}], f"{MOST_ENTRIES} is the most that one may have"),
        ([ENTRIES[0]], "does not begin with a header"),
    ],
)
def test_header_must_fit(lines: list[Json], words: str, tmp_path: Path) -> None:
    """A layout of another version is not guessed at, and a file that lost entries is noticed."""
    refused(packed_as(lines, tmp_path / "x.xz"), words)
