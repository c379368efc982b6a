"""Promise: docs/formats.md and the schemas of docs/schemas say what every golden file holds, as the code reads it."""

import copy
import hashlib
import json
import lzma
import re
import runpy
import shlex
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from checkout import BUNDLES, GOLDEN, PUBLISHED, ROOT
from jsonschema import Draft202012Validator, ValidationError
from numpy.typing import NDArray

from tacevo.config.recorded_parts import code_hash
from tacevo.errors import TacevoError
from tacevo.evolution.run_files import NetworkArchiveFile, PromptFile, line_kind
from tacevo.results.study_lines import StudyRecord, study_line_kind
from tacevo.storage.canonical import canonical
from tacevo.storage.entries import _Header
from tacevo.storage.run_directory import RunRecord, Timing
from tacevo.storage.store import Entry
from tacevo.storage.sweep_directory import SweepRecord
from tacevo.training.weights import weights_digest
from tacevo.typed import convert

SCHEMAS = ROOT / "docs/schemas"
TABLES = ROOT / "cache/tables"

#: Golden files, the small ones first; a quick run reads those.
SMALL = (GOLDEN / "demo.zip", BUNDLES / "force-grammar.zip", PUBLISHED / "words-temperature.zip")
LARGE = sorted({*PUBLISHED.glob("*.zip"), *BUNDLES.glob("*.zip"), *TABLES.glob("*.zip")} - {*SMALL})

#: The schema of each file of records: of a whole file, or of each of its lines.
NAMES = {
    r"table\.json": "table",
    r"networks\.jsonl": "networks",
    r"trainings\.jsonl": "trainings",
    r"store\.jsonl\.xz": "packed",
    r"sweep/sweep\.json": "sweep",
    r".*/study\.json": "study",
    r".*/scores\.jsonl": "scores",
    r".*/(run|archive|prompts)\.json": r"\1",
    r".*/(ledger|timings)\.jsonl": r"\1",
}

#: The class that the code reads a record by, where that is one class and in no room.
CLASSES = {
    "run": RunRecord,
    "archive": NetworkArchiveFile,
    "prompts": PromptFile,
    "timings": Timing,
    "study": StudyRecord,
    "sweep": SweepRecord,
}


@cache
def validator(name: str) -> Draft202012Validator:
    """Return the validator of a schema as it is committed."""
    return Draft202012Validator(json.loads((SCHEMAS / f"{name}.json").read_text(encoding="utf-8")))


def records(bundle: Path) -> Iterator[tuple[str, str, Any]]:
    """Yield the records of a golden file: the schema of each, its place, and what it holds."""
    with zipfile.ZipFile(bundle) as archive:
        for member in archive.namelist():
            found = next(
                (match.expand(to) for name, to in NAMES.items() if (match := re.fullmatch(name, member))), None
            )
            if found is None:
                continue
            data = archive.read(member)
            texts = (lzma.decompress(data) if member.endswith(".xz") else data).splitlines()
            for number, text in enumerate(texts if "jsonl" in member else [data], start=1):
                yield found, f"{member}, line {number}", json.loads(text)


@pytest.mark.parametrize(
    "bundle",
    [*SMALL, *(pytest.param(path, marks=[pytest.mark.slow, pytest.mark.timeout(3600)]) for path in LARGE)],
    ids=lambda path: path.stem,
)
def test_golden_files_keep_their_schemas(bundle: Path) -> None:
    """Every record of every bundle and table, of whatever release, by a validator that is not ours."""
    seen = set()
    for name, place, record in records(bundle):
        seen.add(name)
        problems = [f"{place}, {one.json_path}: {one.message[:200]}" for one in validator(name).iter_errors(record)]
        assert problems == []
    assert seen >= ({"table", "networks", "trainings"} if "space" in bundle.stem else {"run", "ledger", "packed"})


def test_golden_ledger_keeps_its_schema() -> None:
    """The ledger that core tests compare with, of which the header is not kept."""
    lines = [json.loads(line) for line in (GOLDEN / "ledger.jsonl").read_text().splitlines()]
    assert lines
    assert [list(validator("ledger").iter_errors(line)) for line in lines] == [[]] * len(lines)


@pytest.mark.room("table")
def test_schemas_are_those_of_the_code() -> None:
    """`make schemas` writes them; there is no other."""
    made = dict(runpy.run_path(str(ROOT / "docs/site/schemas.py"))["texts"]())
    assert made.keys() == {path.name for path in SCHEMAS.iterdir()}
    assert [name for name, text in made.items() if (SCHEMAS / name).read_text(encoding="utf-8") != text] == []
    for text in made.values():
        Draft202012Validator.check_schema(json.loads(text))


def samples() -> Iterator[tuple[str, Any]]:
    """Yield one record of each shape that the small golden files and the table have."""
    seen = set()
    for bundle in (*SMALL, PUBLISHED / "grating-winners.zip", *sorted(TABLES.glob("*.zip"))):
        for name, _, record in records(bundle):
            answer = record.get("answer") if name == "packed" else {}
            told = (record.get("kind"), *(answer if isinstance(answer, dict) else ())) if "kind" in record else ()
            shape = (name, told, "stage" in record, "reason" in record)
            if shape not in seen:
                seen.add(shape)
                yield name, record


def reads(name: str, record: Any) -> bool:
    """Answer whether the code reads a record, apart from its hashes."""
    from tacevo.results import table_records

    of_tables = {"table": "Header", "networks": "TableNetwork", "trainings": "TableTraining"}
    kind: Any = getattr(table_records, of_tables[name]) if name in of_tables else CLASSES.get(name)
    if name == "packed":
        kind = _Header if "entries" in record else Entry
    try:
        if name in {"ledger", "scores"}:
            kind = (line_kind if name == "ledger" else study_line_kind)(record)
            record = {key: value for key, value in record.items() if key not in {"previous", "hash"}}
        convert(kind, record, place="", error=TacevoError)
    except (TacevoError, TypeError):
        return False
    return kind is not None


#: Where a schema and the code differ, by the name of the schema and the field.
APART = {("packed", "request"), ("packed", "answer"), ("networks", "profile")}

#: What is put in the place of a value.
OTHERS: tuple[Any, ...] = ("x", -1, 1.5, True, None, [], {})


def changed(
    record: Any, at: tuple[str | int, ...] = ()
) -> Iterator[tuple[tuple[str | int, ...], Callable[[Any], None]]]:
    """Yield changes to a record: of each field of each object, and of the first value of each list."""
    if isinstance(record, dict):
        yield (*at, "+"), lambda one: one.update({"unknown": 1})
        for key, value in record.items():
            yield (*at, key, "-"), lambda one, key=key: one.pop(key)  # type: ignore[misc]
            for other in OTHERS:
                yield (*at, key), lambda one, key=key, other=other: one.update({key: other})  # type: ignore[misc]
            yield from changed(value, (*at, key))
    elif isinstance(record, list) and record:
        for other in OTHERS:
            yield (*at, 0), lambda one, other=other: one.__setitem__(0, other)  # type: ignore[misc]
        yield from changed(record[0], (*at, 0))


def put(record: Any, at: tuple[str | int, ...], change: Callable[[Any], None]) -> Any:
    """Return a copy of a record with a change of the object, or list, that a place lies in."""
    one = inner = copy.deepcopy(record)
    for key in at[: -2 if at[-1] == "-" else -1]:
        inner = inner[key]
    change(inner)
    return one


@pytest.mark.room("table")
def test_schemas_refuse_what_the_code_refuses() -> None:
    """A field more, a field less, and other values in every place: both say the same.

    A schema cannot say what a record checks of several fields at once, as the graph of a profile does. It has more of
    the entries of stores, which the code reads where it uses them. Settings are free in both.
    """
    differing, tried = [], 0
    for name, record in samples():
        assert reads(name, record)
        for at, change in changed(record):
            if (name, at[0]) in APART or at[0] in {"kind", "previous", "hash"} or (at[0] == "config" and len(at) > 2):
                continue
            other = put(record, at, change)
            if other.get("schema") is True:  # which the code takes for 1, and the schema does not
                continue
            tried += 1
            if validator(name).is_valid(other) != reads(name, other):
                differing.append((name, at, reads(name, other)))
    assert tried > 2_000
    assert differing == []


@pytest.mark.parametrize("kind", ["completions", "evaluations", "studies", "probes", "answers", "arrays"])
def test_schema_of_entries_knows_what_is_asked_and_answered(kind: str) -> None:
    """A number in a question or an answer that has become a text is found, whatever the kind of the entry."""
    found = [record for name, record in samples() if name == "packed" and record.get("kind") == kind]
    assert found
    for record in found:
        for part in ("request", "answer"):
            other = {**record, part: {name: {"x": [1]} for name in record[part]}}
            assert not validator("packed").is_valid(other)


PAGE = (ROOT / "docs/formats.md").read_text(encoding="utf-8")


def test_page_shows_what_the_reader_prints() -> None:
    """Its first command is run, and prints what stands below it; lines are wrapped there."""
    command, shown = re.findall(r"^```(?:sh|text)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)[:2]
    python, *arguments = shlex.split(command)
    assert python == "python"
    done = subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split() == shown.split()


def test_python_of_the_page_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """It validates a ledger; a line that is none is refused."""
    monkeypatch.chdir(ROOT)
    (block,) = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    names: dict[str, Any] = {}
    exec(block, names)
    with pytest.raises(ValidationError):
        names["validate"]({**json.loads(names["line"]), "unknown": 1}, names["schema"])


def test_page_lists_every_schema() -> None:
    """Each is linked from the file that it is of."""
    linked = set(re.findall(r"\(schemas/(\w+\.json)\)", PAGE))
    assert linked == {path.name for path in SCHEMAS.iterdir()}


#: The values of the page's table, by their words.
VALUES = {
    "the float one": 1.0,
    "a hundred-thousandth": 1e-05,
    "ten to the 16th, as a float": 1e16,
    "minus zero": -0.0,
    "ten to the 15th, as a float": 1e15,
}


def test_page_writes_numbers_as_they_are_hashed() -> None:
    """Its table has the canonical text of each value; strings are escaped as it says."""
    rows = dict(re.findall(r"^\| ([^|]*) \| `([^`]*)` \|$", PAGE, re.MULTILINE))
    assert {words: canonical(value) for words, value in VALUES.items()} == {words: rows[words] for words in VALUES}
    assert canonical({"b": '"\\/\x7f\u00e9', "a": "\b\t\n\f\r\x1f"}) == (
        '{"a":"\\b\\t\\n\\f\\r\\u001f","b":"\\"\\\\/\x7f\u00e9"}'
    )


def of_json(value: Any) -> str:
    """Hash JSON as the page says."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


@pytest.mark.room("table")
def test_digest_of_a_table_is_made_as_the_page_says() -> None:
    """The one that replays of it and runs that looked into it have."""
    from tacevo.results.space_table import read_table
    from tacevo.results.table_records import DECISIVE

    (path,) = TABLES.glob("*.zip")
    with zipfile.ZipFile(path) as archive:
        header = json.loads(archive.read("table.json"))
        rows = {name: hashlib.sha256(archive.read(name)).hexdigest() for name in ("networks.jsonl", "trainings.jsonl")}
    settings = {}
    for key in DECISIVE:
        group, _, name = key.partition(".")
        settings[key] = header["config"][group].get(name, {"gpu": "", "precision": "float32"}.get(name))
    told = {name: header[name] for name in ("made_up", "data", "seeds", "study", "trivial")}
    made = of_json({**told, **rows, "settings": settings, "rules": {**header["rules"], "core": 0}})
    assert made == read_table(path).digest


def test_checksum_of_an_entry_and_digests_of_code_and_weights_are_made_as_the_page_says() -> None:
    """Those that the independent reader does not look at."""
    entry = Entry(kind="centroids", request={"niches": 1}, answer=[[0.5, 1e-05]]).sealed()
    assert list(validator("entry").iter_errors(entry)) != []  # a request of another shape
    assert entry.pop("checksum") == of_json(entry)
    sources = {"mine.py": "class Mine: ..."}
    assert code_hash("mine", "Mine", sources) == of_json({"module": "mine", "attribute": "Mine", "sources": sources})
    weights: dict[str, NDArray[Any]] = {"b": np.zeros((2,), np.float32), "a": np.ones((1, 2), np.int64)}
    text = b"a torch.int64 (1, 2)\n" + weights["a"].tobytes() + b"b torch.float32 (2,)\n" + weights["b"].tobytes()
    assert weights_digest(weights) == hashlib.sha256(text).hexdigest()


@pytest.mark.parametrize("stored", ["arrays", "evaluations"])
def test_files_of_stores_keep_their_schema(stored: str) -> None:
    """An entry of a bundle as `tacevo cache import` writes it."""
    _, record = next((name, record) for name, record in samples() if name == "packed" and record.get("kind") == stored)
    assert list(validator("entry").iter_errors(Entry(**record).sealed())) == []
