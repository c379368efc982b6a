"""Promise: an answer is kept under everything that determines it, and comes back as it was written."""

import dataclasses
import errno
import itertools
import json
import os
import random
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from tacevo.errors import CacheMissError
from tacevo.records import ChatMessage, Json, Mode, Request, to_json
from tacevo.storage.canonical import canonical, content_hash, leaves, readable
from tacevo.storage.store import Store

REQUEST = Request(
    model="m",
    system="Be brief.",
    messages=(ChatMessage(role="user", content="Widen it."),),
    temperature=0.5,
    max_tokens=100,
    draw=7,
    settings=(("slip_rate", 0.05),),
)

#: For each field of a request, requests that differ in it alone.
VARIED: dict[str, list[Any]] = {
    "model": ["n", ""],
    "system": ["Be brief. ", "be brief."],
    "messages": [
        (),
        (ChatMessage(role="assistant", content="Widen it."),),
        (ChatMessage(role="user", content="Widen it"),),
        (*REQUEST.messages, *REQUEST.messages),
    ],
    "temperature": [0.5000000000000001, 0.0, 1.0],
    "max_tokens": [101],
    "draw": [8, 0],
    "settings": [
        (),
        (("slip_rate", 0.06),),
        (("slips", 0.05),),
        (("slip_rate", 0.05), ("top_p", 0.9)),
        (("slip_rate", 0.05), ("stop_sequences", ("END",))),
    ],
}

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=10,
)


def forbidden() -> Any:
    """Stand where an answer must not be computed."""
    raise AssertionError("the answer was computed")


def entry_path(root: Path) -> Path:
    """Find the only entry of a store."""
    (path,) = root.rglob("*.json")
    return path


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Return a store with one recorded answer."""
    made = Store(tmp_path, "things")
    made.write({"x": 1}, {"y": "ünï\u2028 \x00"})
    return made


def test_written_forms_are_golden() -> None:
    """Text as it is: every key of every store rests on the canonical form, every file of a record on the other."""
    assert canonical({"b": [1, 1.0, None, True], "a": 'ü"\n'}) == '{"a":"ü\\"\\n","b":[1,1.0,null,true]}'
    assert readable({"b": [1.0, True], "a": 'ü"\n'}) == '{\n "b": [\n  1.0,\n  true\n ],\n "a": "ü\\"\\n"\n}\n'


@pytest.mark.parametrize("field", [field.name for field in dataclasses.fields(Request)])
def test_every_field_enters_the_key(field: str, tmp_path: Path) -> None:
    """Requests that differ in any one field, by however little, have different keys, and the key of one is golden."""
    store = Store(tmp_path, "completions")
    others = [dataclasses.replace(REQUEST, **{field: value}) for value in VARIED[field]]
    keys = {store.key(to_json(request)) for request in [REQUEST, *others]}
    assert len(keys) == 1 + len(others)
    assert "7e420a3a685fcd6befbd10a275c033733400dcc518e05141bccc16c45a93ec03" in keys
    assert Store(tmp_path, "others").key(to_json(REQUEST)) not in keys


def test_leaves_bear_their_whole_keys_in_order() -> None:
    """A list is one value, and so is an empty mapping: else a key would stand there that nobody has looked at."""
    nested: dict[str, Json] = {"b": {"y": 1, "x": {"z": [2]}}, "a": None, "${HOME}": {}}
    assert list(leaves(nested)) == [("b.y", 1), ("b.x.z", [2]), ("a", None), ("${HOME}", {})]


@given(JSON, JSON)
def test_equal_hashes_mean_equal_json(first: Any, second: Any) -> None:
    """Two values share a hash only where they share their canonical form."""
    assert (content_hash(first) == content_hash(second)) == (canonical(first) == canonical(second))


@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf")])
def test_nan_is_refused(number: float, store: Store) -> None:
    """NaN and infinity are neither asked nor answered, and a refused answer leaves no file."""
    with pytest.raises(ValueError, match="not JSON compliant"):
        store.key({"x": number})
    with pytest.raises(ValueError, match="not JSON compliant"):
        store.write({"x": 2}, {"y": [number]})
    assert store.read({"x": 2}) is None


@given(answer=JSON.filter(lambda value: value is not None))
def test_answer_comes_back_as_it_was_written(answer: Any, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Whatever JSON is written is read, number for number and character for character."""
    store = Store(tmp_path_factory.mktemp("store"), "things")
    store.write({"x": 1}, answer)
    assert canonical(store.read({"x": 1})) == canonical(answer)


def test_mode_says_what_is_read_and_computed(tmp_path: Path) -> None:
    """`record` computes once; `live` always, and records the last answer; `replay` never, and a miss is an error."""
    live, record, replay = (Store(tmp_path, "things", mode) for mode in (Mode.live, Mode.record, Mode.replay))
    answers = itertools.count()
    assert [live.recall({"x": 1}, lambda: next(answers)) for _ in range(2)] == [0, 1]
    assert record.recall({"x": 1}, forbidden) == replay.recall({"x": 1}, forbidden) == 1
    assert record.recall({"x": 2}, lambda: 5) == record.recall({"x": 2}, forbidden) == 5
    with refused(CacheMissError, got="no recorded answer for things request"):
        replay.recall({"x": 3}, forbidden)
    with refused(CacheMissError, remedy="that store is empty or absent: name it by"):
        Store(tmp_path, "others", Mode.replay).find({"x": 1})


@pytest.mark.parametrize("error", [None, errno.EPERM, errno.EOPNOTSUPP, errno.EXDEV])
def test_first_recorded_answer_stands(error: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever asked the same meanwhile goes on with what a replay will read; also where a file has one name only."""
    if error is not None:
        monkeypatch.setattr(os, "link", Mock(side_effect=OSError(error, "no links")))
    store = Store(tmp_path, "things")

    def late() -> Json:
        store.write({"x": 1}, "of another process")
        return "mine"

    assert store.recall({"x": 1}, late) == store.read({"x": 1}) == "of another process"
    assert not list(tmp_path.rglob("*.part"))


def test_name_without_a_file_is_no_answer(tmp_path: Path) -> None:
    """As where a store is kept in git-annex, and its content is elsewhere: the answer takes its place."""
    store = Store(tmp_path, "things")
    path = store.path(store.key({"x": 1}))
    path.parent.mkdir(parents=True)
    path.symlink_to(tmp_path / "elsewhere")
    assert store.recall({"x": 1}, lambda: "mine") == store.read({"x": 1}) == "mine"


def test_all_who_ask_at_once_get_the_answer_that_stands(tmp_path: Path) -> None:
    """None of eight found one when it began to ask."""
    store, together = Store(tmp_path, "things"), threading.Barrier(8, timeout=60)

    def ask(number: int) -> Json:
        def compute() -> Json:
            together.wait()
            return number

        return store.recall({"x": 1}, compute)

    with ThreadPoolExecutor(8) as pool:
        assert set(pool.map(ask, range(8))) == {store.read({"x": 1})}


def test_failed_computation_stores_nothing(tmp_path: Path) -> None:
    """An exception passes through, and the next asker computes again."""
    store = Store(tmp_path, "things")

    def fail() -> Any:
        raise OSError("no network")

    with pytest.raises(OSError, match="no network"):
        store.recall({"x": 1}, fail)
    assert store.recall({"x": 1}, lambda: 5) == 5


@pytest.mark.parametrize(
    ("recorded", "asked", "field"),
    [
        ({"a": 1, "b": {"c": 2}}, {"a": 1, "b": {"c": 3}}, "b.c"),
        ({"a": 1, "b": [{"c": 2}]}, {"a": 1, "b": [{"c": 3}]}, "b.0.c"),
        ({"a": 1, "b": [1]}, {"a": 1, "b": []}, "b"),
        ({"a": 1, "b": 1}, {"a": 2, "b": 2}, "a"),
        ({}, {"x": None}, "x"),
        ({"x": None}, {}, "x"),
        ({"x": 1}, {"x": 1.0}, "x"),
        ({"a.b": 1, "x": 1}, {"a.b": 2, "x": 1}, "a.b"),
    ],
)
def test_miss_names_the_nearest_recording_and_the_first_field(
    recorded: Any, asked: Any, field: str, tmp_path: Path
) -> None:
    """Of several the one that differs least; a null is not a missing field, nor 1 a 1.0, as their keys differ."""
    store = Store(tmp_path, "things")
    for request in (recorded, {"a": 7, "b": 8, "c": 9, "d": 10}):
        store.write(request, "answer")
    nearest = f"nearest recording is {store.key(recorded)[:12]}, whose field '{field}' differs"
    with refused(CacheMissError, got=nearest):
        Store(tmp_path, "things", Mode.replay).find(asked)


def test_entries_are_readable_and_come_in_the_order_of_keys(tmp_path: Path) -> None:
    """A file shows what was asked and answered; what a killed writer left has another name, and nobody reads it."""
    store = Store(tmp_path, "things")
    for number in range(20):
        store.write({"x": number}, number)
    path = store.path(store.key({"x": 1}))
    path.with_name(f".{path.name}.123-456.part").write_text("{", encoding="utf-8")
    entry = json.loads(path.read_text(encoding="utf-8"))
    assert (entry["request"], entry["answer"]) == ({"x": 1}, 1)
    assert [entry.key for entry in store.entries()] == sorted(store.key({"x": number}) for number in range(20))


def test_every_entry_that_is_read_is_told(tmp_path: Path) -> None:
    """Whoever wants to know what a run needs hears of each entry that was found, and of no other."""
    seen: list[Path] = []
    watched = Store(tmp_path, "things", seen=seen.append)
    watched.write({"x": 1}, "one")
    assert seen == []
    assert (watched.read({"x": 1}), watched.read({"x": 2})) == ("one", None)
    assert seen == [entry_path(tmp_path)]


@given(st.dictionaries(st.text(), JSON, max_size=5), st.randoms(use_true_random=False))
def test_order_of_fields_changes_no_key(request: dict[str, Any], shuffler: random.Random) -> None:
    """A request that was written down in another order, at any depth, is the same request."""

    def shuffled(value: Any) -> Any:
        if isinstance(value, dict):
            names = sorted(value)
            shuffler.shuffle(names)
            return {name: shuffled(value[name]) for name in names}
        return [shuffled(inner) for inner in value] if isinstance(value, list) else value

    store = Store(Path(), "completions")
    assert store.key(shuffled(request)) == store.key(request)
