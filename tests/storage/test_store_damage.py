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


@pytest.mark.parametrize("field", ["answer", "request", "kind", "key", "checksum"])
def test_edited_entry_is_an_error(field: str, store: Store, tmp_path: Path) -> None:
    """A change of any field is noticed by the checksum."""
    path = entry_path(tmp_path)
    edited(path, lambda entry: {**entry, field: "edited"})
    with refused(StoreError, place=path.name, expected="fits its name and its checksum", remedy="restore the file"):
        store.read({"x": 1})


def test_answer_edited_to_nan_is_an_error(store: Store, tmp_path: Path) -> None:
    """NaN, which JSON readers let pass, is damage like any other."""
    edited(entry_path(tmp_path), lambda entry: {**entry, "answer": float("nan")})
    with refused(StoreError, expected="fits its name and its checksum", remedy="restore the file"):
        store.read({"x": 1})


def test_sound_entry_under_another_key_is_an_error(store: Store, tmp_path: Path) -> None:
    """A file that was renamed to another request's key does not answer that request."""
    path = entry_path(tmp_path)
    target = tmp_path / "things" / store.key({"x": 2})[:2] / f"{store.key({'x': 2})}.json"
    target.parent.mkdir(exist_ok=True)
    path.rename(target)
    with refused(StoreError, expected="fits its name and its checksum"):
        store.read({"x": 2})


def test_unknown_schema_is_an_error(store: Store, tmp_path: Path) -> None:
    """An entry of a later version is refused by its schema, although its checksum is right."""
    edited(entry_path(tmp_path), lambda entry: resealed({**entry, "schema": 99}))
    with refused(StoreError, place="schema", expected="1", got="99"):
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
        found, refusal = answer_or_refusal(store)
        if refusal:
            refusals += 1
            assert "restore the file from a copy, or delete it" in refusal
        else:
            assert found == answer
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


def test_entry_with_another_question_is_an_error_although_resealed(store: Store, tmp_path: Path) -> None:
    """Who edits the question and mends the checksum is found by the key, which is the question's."""
    edited(entry_path(tmp_path), lambda entry: resealed({**entry, "request": {"x": 2}}))
    with refused(StoreError, expected="fits its name and its checksum", remedy="restore"):
        store.read({"x": 1})


@pytest.mark.parametrize("part", ["kind", "request", "answer"])
def test_entry_without_a_part_is_an_error(part: str, tmp_path: Path) -> None:
    """A right checksum over an entry that lacks a part is not an answer."""
    Store(tmp_path, "things").write({"x": 1}, "one")
    path = entry_path(tmp_path)
    entry = {key: value for key, value in json.loads(path.read_text()).items() if key not in {part, "checksum"}}
    path.write_text(json.dumps({**entry, "checksum": content_hash(entry)}))
    with refused(StoreError, place=part, expected="a value", remedy="restore the file"):
        Store(tmp_path, "things").read({"x": 1})
