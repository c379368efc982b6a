"""Promise: a damaged entry is an error that names the file and says what to do, never another answer.

Each damage that a file can take has its own test, because a store that answers wrongly is worse than none.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from refusals import refused

from tacevo.errors import CacheMissError, StoreError
from tacevo.records import Mode
from tacevo.storage.canonical import content_hash
from tacevo.storage.store import Store

MISSING = object()


def entry_path(root: Path) -> Path:
    """Find the only entry of a store."""
    (path,) = root.rglob("*.json")
    return path


def edited(path: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    """Change an entry as somebody with an editor would."""
    entry = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(change(entry)), encoding="utf-8")


def resealed(entry: dict[str, Any]) -> dict[str, Any]:
    """Give an entry the checksum of its content."""
    entry.pop("checksum")
    return {**entry, "checksum": content_hash(entry)}


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Return a store with one recorded answer."""
    made = Store(tmp_path, "things")
    made.write({"x": 1}, {"y": "ünï\u2028 \x00"})
    return made


@pytest.mark.parametrize("content", [b"\xff\xfe\x00garbage", b"null", b"[]", b'"text"', b"{}", b"\x80"])
def test_foreign_content_is_an_error(content: bytes, store: Store, tmp_path: Path) -> None:
    """A file that is something else altogether is refused alike, be it not even text."""
    entry_path(tmp_path).write_bytes(content)
    with refused(StoreError, remedy="restore the file"):
        store.read({"x": 1})


FITS = "fits its name and its checksum"


@pytest.mark.parametrize(
    ("change", "place", "expected"),
    [
        *(({field: "edited"}, ".json", FITS) for field in ("answer", "request", "kind", "key", "checksum")),
        ({"answer": float("nan")}, ".json", FITS),
        ({"schema": 99, "checksum": None}, "schema", "1"),
        ({"request": {"x": 2}, "checksum": None}, ".json", FITS),
        *(({part: MISSING, "checksum": None}, part, "a value") for part in ("kind", "request", "answer")),
    ],
)
def test_edited_entry_is_an_error(
    change: dict[str, Any], place: str, expected: str, store: Store, tmp_path: Path
) -> None:
    """Any field, and a field less; also under the checksum of its content (None here), where the key is another's."""

    def edit(entry: dict[str, Any]) -> dict[str, Any]:
        changed = {name: value for name, value in {**entry, **change}.items() if value is not MISSING}
        return resealed(changed) if changed["checksum"] is None else changed

    edited(entry_path(tmp_path), edit)
    with refused(StoreError, place=place, expected=expected, remedy="restore the file"):
        store.read({"x": 1})


def test_sound_entry_under_another_key_is_an_error(store: Store, tmp_path: Path) -> None:
    """A file that was renamed to another request's key does not answer that request."""
    path = entry_path(tmp_path)
    target = tmp_path / "things" / store.key({"x": 2})[:2] / f"{store.key({'x': 2})}.json"
    target.parent.mkdir(exist_ok=True)
    path.rename(target)
    with refused(StoreError, expected="fits its name and its checksum", got="renamed or edited"):
        store.read({"x": 2})


def test_content_that_was_edited_is_not_said_to_be_renamed(store: Store, tmp_path: Path) -> None:
    """Its name and its key are those of its question: what was written into it is another answer."""
    edited(entry_path(tmp_path), lambda entry: {**entry, "answer": {"y": 3}})
    with refused(StoreError, got="edited or damaged"):
        store.read({"x": 1})


def test_damaged_entry_is_never_computed_again(store: Store, tmp_path: Path) -> None:
    """Damage is an error in `record` mode, too, and not a silent call."""
    entry_path(tmp_path).write_bytes(b"{")
    with refused(StoreError, expected="JSON"):
        store.recall({"x": 1}, lambda: pytest.fail("the answer was computed"))


def test_entry_cut_at_any_byte_is_refused(store: Store, tmp_path: Path) -> None:
    """Truncated anywhere before its last line feed, an entry is an error that says what to do."""
    path = entry_path(tmp_path)
    whole = path.read_bytes()
    for length in range(len(whole) - 1):
        path.write_bytes(whole[:length])
        with refused(StoreError, remedy="restore the file from a copy, or delete it"):
            store.read({"x": 1})


@pytest.mark.parametrize("step", [7, pytest.param(1, marks=pytest.mark.slow)], ids=["every byte", "every bit"])
def test_any_flipped_bit_of_an_entry_is_refused_or_harmless(step: int, store: Store, tmp_path: Path) -> None:
    """No bit of an entry changes an answer: it is refused, but for blanks between the values."""
    path = entry_path(tmp_path)
    whole, answer = path.read_bytes(), store.read({"x": 1})
    refusals, places = 0, range(0, 8 * len(whole), step)
    for place in places:
        data = bytearray(whole)
        data[place // 8] ^= 1 << place % 8
        path.write_bytes(data)
        answer_read, refusal = answer_or_refusal(store)
        if refusal:
            refusals += 1
            assert "restore the file from a copy, or delete it" in refusal
        else:
            assert answer_read == answer
    assert refusals > 0.99 * len(places)


def answer_or_refusal(store: Store) -> tuple[Any, str]:
    """Read the recorded answer; where it is refused, return the words of that."""
    try:
        return store.read({"x": 1}), ""
    except StoreError as error:
        return None, str(error)


def test_damaged_neighbour_does_not_hide_a_miss(tmp_path: Path) -> None:
    """What is missing is what the message is about, not another file of the store."""
    store = Store(tmp_path, "completions")
    store.write({"a": 1}, "one")
    (tmp_path / "completions" / "00").mkdir()
    (tmp_path / "completions" / "00" / "00.json").write_text("{")
    with refused(CacheMissError, got="whose field 'a' differs"):
        Store(tmp_path, "completions", Mode.replay).find({"a": 2})
