"""Promise: an answer is kept under everything that determines it, and comes back as it was written."""

import dataclasses
import itertools
import json
import random
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from tacevo.errors import CacheMissError
from tacevo.records import Message, Mode, Request, to_json
from tacevo.storage.canonical import canonical, content_hash
from tacevo.storage.store import Store

REQUEST = Request(
    model="m",
    system="Be brief.",
    messages=(Message(role="user", content="Widen it."),),
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
        (Message(role="assistant", content="Widen it."),),
        (Message(role="user", content="Widen it"),),
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


def test_canonical_form_is_golden() -> None:
    """Keys in order, no spaces, text as it is: every key of every store rests on this form."""
    assert canonical({"b": [1, 1.0, None, True], "a": 'ü"\n'}) == '{"a":"ü\\"\\n","b":[1,1.0,null,true]}'


def test_request_key_is_golden(tmp_path: Path) -> None:
    """A recorded answer is found again only as long as its key is made alike."""
    golden = "7e420a3a685fcd6befbd10a275c033733400dcc518e05141bccc16c45a93ec03"
    assert Store(tmp_path, "completions").key(to_json(REQUEST)) == golden


def test_every_field_of_a_request_is_varied_here() -> None:
    """A field that is added to a request must be added to the test below."""
    assert set(VARIED) == {field.name for field in dataclasses.fields(Request)}


@pytest.mark.parametrize("field", VARIED)
def test_every_field_enters_the_key(field: str, tmp_path: Path) -> None:
    """Requests that differ in any one field, by however little, have different keys."""
    store = Store(tmp_path, "completions")
    others = [dataclasses.replace(REQUEST, **{field: value}) for value in VARIED[field]]
    assert len({store.key(to_json(request)) for request in [REQUEST, *others]}) == 1 + len(others)


def test_kind_enters_the_key(tmp_path: Path) -> None:
    """Equal requests to two kinds of store have different keys."""
    assert Store(tmp_path, "a").key({"x": 1}) != Store(tmp_path, "b").key({"x": 1})


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


def test_record_computes_once(tmp_path: Path) -> None:
    """In `record` mode the first answer is computed and stored, the second read."""
    store = Store(tmp_path, "things", Mode.record)
    assert store.recall({"x": 1}, lambda: 5) == 5
    assert store.recall({"x": 1}, forbidden) == 5


def test_live_never_reads_but_writes(tmp_path: Path) -> None:
    """In `live` mode every answer is computed anew, and the last one is recorded."""
    store = Store(tmp_path, "things", Mode.live)
    answers = itertools.count()
    assert [store.recall({"x": 1}, lambda: next(answers)) for _ in range(2)] == [0, 1]
    assert Store(tmp_path, "things", Mode.replay).recall({"x": 1}, forbidden) == 1


def test_replay_never_computes(store: Store, tmp_path: Path) -> None:
    """In `replay` mode a recorded answer is read, and a missing one is an error."""
    replay = Store(tmp_path, "things", Mode.replay)
    assert replay.recall({"x": 1}, forbidden) == store.read({"x": 1})
    with refused(CacheMissError, got="no recorded answer for things request"):
        replay.recall({"x": 2}, forbidden)


def test_failed_computation_stores_nothing(tmp_path: Path) -> None:
    """An exception passes through, and the next asker computes again."""
    store = Store(tmp_path, "things")

    def fail() -> Any:
        raise OSError("no network")

    with pytest.raises(OSError, match="no network"):
        store.recall({"x": 1}, fail)
    assert store.recall({"x": 1}, lambda: 5) == 5


def test_miss_in_an_empty_store_says_so(tmp_path: Path) -> None:
    """Where nothing was recorded, the message says how to record."""
    with refused(CacheMissError, remedy="that store is empty or absent: name it by"):
        Store(tmp_path, "things", Mode.replay).find({"x": 1})


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"temperature": 0.6}, "temperature"),
        ({"model": "n", "temperature": 0.6}, "model"),
        ({"messages": (Message(role="user", content="Narrow it."),)}, "messages.0.content"),
        ({"messages": ()}, "messages"),
        ({"settings": (("slip_rate", 0.1),)}, "settings.0.1"),
    ],
)
def test_miss_names_the_nearest_recording_and_the_first_field(
    change: dict[str, Any], field: str, tmp_path: Path
) -> None:
    """Of several recordings the message names the one that differs least, and where."""
    record = Store(tmp_path, "completions")
    for request in (dataclasses.replace(REQUEST, model="x", system="y", draw=0, max_tokens=1), REQUEST):
        record.write(to_json(request), "answer")
    asked = to_json(dataclasses.replace(REQUEST, **change))
    expected = f"nearest recording is {record.key(to_json(REQUEST))[:12]}, whose field '{field}' differs"
    with refused(CacheMissError, got=expected):
        Store(tmp_path, "completions", Mode.replay).find(asked)


@pytest.mark.parametrize(("recorded", "asked"), [({}, {"x": None}), ({"x": None}, {}), ({"x": 1}, {"x": 1.0})])
def test_miss_sees_every_difference_that_a_key_sees(recorded: Any, asked: Any, tmp_path: Path) -> None:
    """A null is not a missing field, nor 1 a 1.0: their keys differ, and the message says where."""
    Store(tmp_path, "things").write(recorded, 5)
    with refused(CacheMissError, got="whose field 'x' differs"):
        Store(tmp_path, "things", Mode.replay).find(asked)


def test_entry_is_readable_and_holds_the_request(store: Store, tmp_path: Path) -> None:
    """Somebody who looks into the directory sees what was asked and what was answered."""
    assert entry_path(tmp_path).name == f"{store.key({'x': 1})}.json"
    entry = json.loads(entry_path(tmp_path).read_text(encoding="utf-8"))
    assert (entry["request"], entry["answer"]) == ({"x": 1}, store.read({"x": 1}))


def test_entries_come_in_the_order_of_keys(tmp_path: Path) -> None:
    """All entries are given, each checked, whatever order they were written in."""
    store = Store(tmp_path, "things")
    for number in range(20):
        store.write({"x": number}, number)
    keys = [entry.key for entry in store.entries()]
    assert keys == sorted(store.key({"x": number}) for number in range(20))


def test_every_entry_that_is_read_is_told(tmp_path: Path) -> None:
    """Whoever wants to know what a run needs hears of each entry that was found, and of no other."""
    seen: list[Path] = []
    watched = Store(tmp_path, "things", seen=seen.append)
    watched.write({"x": 1}, "one")
    assert seen == []
    assert (watched.read({"x": 1}), watched.read({"x": 2})) == ("one", None)
    assert seen == [entry_path(tmp_path)]


def test_nearest_is_another_recording_with_all_its_differences(tmp_path: Path) -> None:
    """The entry itself is not its own neighbour, and every field that differs is named."""
    store = Store(tmp_path, "things")
    for request in ({"a": 1, "b": 1, "c": 1}, {"a": 1, "b": 2, "c": 2}, {"a": 2, "b": 2, "c": 2}):
        store.write(request, "answer")
    found = store.nearest({"a": 1, "b": 1, "c": 1})
    assert found is not None
    assert (found[0].request, found[1]) == ({"a": 1, "b": 2, "c": 2}, [("b",), ("c",)])
    assert Store(tmp_path, "others").nearest({"a": 1}) is None


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


def test_file_left_by_a_killed_writer_is_not_an_entry(store: Store, tmp_path: Path) -> None:
    """A half-written file has another name, and nobody reads it."""
    path = entry_path(tmp_path)
    path.with_name(f".{path.name}.123-456.part").write_text("{", encoding="utf-8")
    assert len(list(store.entries())) == 1
