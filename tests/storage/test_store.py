"""Promise: an answer is kept under everything that determines it, and comes back whole or with an error, never wrong.

Each damage that a file can take has its own test, because a store that answers wrongly is worse than none.
"""

import dataclasses
import errno
import itertools
import json
import os
import random
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from tacevo.errors import CacheMissError, StoreError
from tacevo.records import Message, Mode, Request, to_json
from tacevo.storage.canonical import canonical, content_hash
from tacevo.storage.files import sweep, write_durably
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

#: Writes answers of 100,000 equal digits under one key, again and again.
WRITER = """
import sys
from pathlib import Path
from tacevo.storage.store import Store
store = Store(Path(sys.argv[1]), "shared")
for _ in range(30):
    store.write({"x": 1}, sys.argv[2] * 100_000)
"""

#: Begins to write a file, says so, and never comes to an end.
STOPPED_WRITER = """
import sys, time
from pathlib import Path
from tacevo.storage.store import write_durably
class Endless(str):
    def encode(self):
        print("writing", flush=True)
        time.sleep(1000)
write_durably(Path(sys.argv[1]), Endless())
"""


def forbidden() -> Any:
    """Stand where an answer must not be computed."""
    raise AssertionError("the answer was computed")


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
    with pytest.raises(CacheMissError, match="no recorded answer for things request"):
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
    with pytest.raises(CacheMissError, match=expected):
        Store(tmp_path, "completions", Mode.replay).find(asked)


@pytest.mark.parametrize(("recorded", "asked"), [({}, {"x": None}), ({"x": None}, {}), ({"x": 1}, {"x": 1.0})])
def test_miss_sees_every_difference_that_a_key_sees(recorded: Any, asked: Any, tmp_path: Path) -> None:
    """A null is not a missing field, nor 1 a 1.0: their keys differ, and the message says where."""
    Store(tmp_path, "things").write(recorded, 5)
    with pytest.raises(CacheMissError, match="whose field 'x' differs"):
        Store(tmp_path, "things", Mode.replay).find(asked)


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
    with refused(StoreError, expected="JSON", remedy="restore the file"):
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
        store.recall({"x": 1}, forbidden)


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


def test_file_left_by_a_killed_writer_is_not_an_entry(store: Store, tmp_path: Path) -> None:
    """A half-written file has another name, and nobody reads it."""
    path = entry_path(tmp_path)
    path.with_name(f".{path.name}.123-456.part").write_text("{", encoding="utf-8")
    assert len(list(store.entries())) == 1


def test_sweep_takes_the_parts_of_the_dead_and_leaves_those_of_the_living(store: Store, tmp_path: Path) -> None:
    """A file in the making goes when its writer was killed, not while it writes, and nothing else is touched."""
    writing = [sys.executable, "-c", STOPPED_WRITER, str(tmp_path / "things" / "aa" / "entry.json")]
    before = {path for path in tmp_path.rglob("*") if path.is_file()}
    foreign = tmp_path / "things" / ".somebody.part"
    foreign.write_text("mine")
    with subprocess.Popen(writing, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "writing\n"
        assert len(list(tmp_path.rglob(".entry.json.*.part"))) == 1
        sweep(tmp_path)
        assert len(list(tmp_path.rglob(".entry.json.*.part"))) == 1
        writer.kill()
    assert len(list(tmp_path.rglob(".entry.json.*.part"))) == 1
    sweep(tmp_path)
    assert {path for path in tmp_path.rglob("*") if path.is_file()} == before | {foreign}


def test_writers_are_not_disturbed_by_sweeps(tmp_path: Path) -> None:
    """A sweep that never ends takes no file from a living writer."""
    writers = [subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path), digit]) for digit in "12"]
    while any(writer.poll() is None for writer in writers):
        sweep(tmp_path)
    assert [writer.returncode for writer in writers] == [0, 0]
    assert len(list(tmp_path.rglob("*.part"))) == 0


def test_entry_cut_at_any_byte_is_refused(store: Store, tmp_path: Path) -> None:
    """Truncated anywhere before its last line feed, an entry is an error that says what to do."""
    path = entry_path(tmp_path)
    whole = path.read_bytes()
    for length in range(len(whole) - 1):
        path.write_bytes(whole[:length])
        with refused(StoreError, remedy="restore the file from a copy, or delete it"):
            store.read({"x": 1})


def test_any_flipped_bit_of_an_entry_is_refused_or_harmless(store: Store, tmp_path: Path) -> None:
    """No bit of an entry changes an answer: it is refused, but for blanks between the values."""
    path = entry_path(tmp_path)
    whole, answer = path.read_bytes(), store.read({"x": 1})
    refusals = 0
    for place in range(8 * len(whole)):
        data = bytearray(whole)
        data[place // 8] ^= 1 << place % 8
        path.write_bytes(data)
        found, refusal = answer_or_refusal(store)
        if refusal:
            refusals += 1
            assert "restore the file from a copy, or delete it" in refusal
        else:
            assert found == answer
    assert refusals > 0.99 * 8 * len(whole)


def answer_or_refusal(store: Store) -> tuple[Any, str]:
    """Read the recorded answer; where it is refused, return the words of that."""
    try:
        return store.read({"x": 1}), ""
    except StoreError as error:
        return None, str(error)


#: Makes `flock` fail as where a file system has no locks, with the error that the environment names.
LOCKLESS = """
#include <errno.h>
#include <stdlib.h>
int flock(int file, int operation) {
    errno = atoi(getenv("LOCKLESS_ERROR"));
    return -1;
}
"""


@pytest.fixture(scope="module")
def lockless(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a library that takes the locks from a process, where there is a compiler."""
    if shutil.which("cc") is None:
        pytest.skip("a file system without locks needs a C compiler")
    folder = tmp_path_factory.mktemp("lockless")
    (folder / "lockless.c").write_text(LOCKLESS)
    subprocess.run(["cc", "-shared", "-fPIC", "-o", "lockless.so", "lockless.c"], cwd=folder, check=True)
    return folder / "lockless.so"


def without_locks(code: str, error: int, library: Path, folder: Path) -> str:
    """Run code with a directory as its argument, where `flock` fails; return the last line of its errors."""
    environment = {**os.environ, "LD_PRELOAD": str(library), "LOCKLESS_ERROR": str(error)}
    command = [sys.executable, "-c", code, str(folder)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    return "" if done.returncode == 0 else done.stderr.splitlines()[-1]


WRITE = "import sys, pathlib, tacevo.storage.store as s; s.write_durably(pathlib.Path(sys.argv[1]) / 'file', 'new')"
SWEEP = "import sys, pathlib, tacevo.storage.store as s; s.sweep(pathlib.Path(sys.argv[1]))"


@pytest.mark.parametrize("error", [errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK])
def test_file_system_without_locks_is_written_to_and_never_swept(error: int, lockless: Path, tmp_path: Path) -> None:
    """Nobody knows there whether a file's writer lives, so it stays; what is written is whole all the same."""
    part = tmp_path / ".file.0123456789abcdef.part"
    part.write_text("{")
    assert without_locks(WRITE, error, lockless, tmp_path) == ""
    assert without_locks(SWEEP, error, lockless, tmp_path) == ""
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {part.name: "{", "file": "new"}


def test_lock_that_fails_otherwise_stops_a_write(lockless: Path, tmp_path: Path) -> None:
    """A disk that cannot be read is not a file system without locks: the write is refused and leaves nothing."""
    assert "cannot be written: Input/output error" in without_locks(WRITE, errno.EIO, lockless, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_failed_write_leaves_the_old_content_and_no_rest(tmp_path: Path) -> None:
    """A text that cannot be written to its end (here: half a surrogate pair) changes nothing."""
    path = tmp_path / "file"
    write_durably(path, "old")
    with pytest.raises(UnicodeEncodeError):
        write_durably(path, "new \ud800")
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]
    assert path.read_text(encoding="utf-8") == "old"


def test_two_processes_write_at_once(tmp_path: Path) -> None:
    """While two processes write one key, a reader sees the one answer or the other, and always a whole one."""
    writers = [subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path), digit]) for digit in "12"]
    store = Store(tmp_path, "shared")
    seen = set()
    while any(writer.poll() is None for writer in writers):
        seen.add(store.read({"x": 1}))
    assert [writer.returncode for writer in writers] == [0, 0]
    assert store.read({"x": 1}) in {"1" * 100_000, "2" * 100_000}
    assert seen <= {None, "1" * 100_000, "2" * 100_000}
    assert len(list(tmp_path.rglob("*.part"))) == 0


def test_damaged_neighbour_does_not_hide_a_miss(tmp_path: Path) -> None:
    """What is missing is what the message is about, not another file of the store."""
    store = Store(tmp_path, "completions")
    store.write({"a": 1}, "one")
    (tmp_path / "completions" / "00").mkdir()
    (tmp_path / "completions" / "00" / "00.json").write_text("{")
    with pytest.raises(CacheMissError, match="whose field 'a' differs"):
        Store(tmp_path, "completions", Mode.replay).find({"a": 2})


def test_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    """A file in the place of the store's directory is the user's to mend, and is left alone."""
    (tmp_path / "completions").write_text("mine")
    with pytest.raises(StoreError, match="cannot be written: Not a directory; what stood there is unchanged"):
        Store(tmp_path, "completions").write({"a": 1}, "one")
    assert (tmp_path / "completions").read_text() == "mine"


def test_entry_with_another_question_is_an_error_although_resealed(store: Store, tmp_path: Path) -> None:
    """Who edits the question and mends the checksum is found by the key, which is the question's."""
    edited(entry_path(tmp_path), lambda entry: resealed({**entry, "request": {"x": 2}}))
    with refused(StoreError, expected="fits its name and its checksum", remedy="restore"):
        store.read({"x": 1})


def test_every_entry_that_is_read_is_told(tmp_path: Path) -> None:
    """Whoever wants to know what a run needs hears of each entry that was found, and of no other."""
    seen: list[Path] = []
    watched = Store(tmp_path, "things", seen=seen.append)
    watched.write({"x": 1}, "one")
    assert seen == []
    assert (watched.read({"x": 1}), watched.read({"x": 2})) == ("one", None)
    assert seen == [entry_path(tmp_path)]


@pytest.mark.parametrize("part", ["kind", "request", "answer"])
def test_entry_without_a_part_is_an_error(part: str, tmp_path: Path) -> None:
    """A right checksum over an entry that lacks a part is not an answer."""
    Store(tmp_path, "things").write({"x": 1}, "one")
    path = entry_path(tmp_path)
    entry = {key: value for key, value in json.loads(path.read_text()).items() if key not in {part, "checksum"}}
    path.write_text(json.dumps({**entry, "checksum": content_hash(entry)}))
    with refused(StoreError, place=part, expected="a value", remedy="restore the file"):
        Store(tmp_path, "things").read({"x": 1})


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
