"""Promise: the digest stands for every decision; a killed run goes on where it was; no change goes unnoticed."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from full_disks import largest_file
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from tacevo.errors import DivergenceError, RunError
from tacevo.records import written
from tacevo.storage.canonical import canonical, content_hash
from tacevo.storage.ledger import GENESIS, Ledger, Sealed, read_lines, seal, sealed_text


@dataclass(frozen=True, kw_only=True)
class Header:
    """A first line."""

    config: dict[str, int]
    schema: int = 0
    kind: str = "run"


@dataclass(frozen=True, kw_only=True)
class Slot:
    """A line in between."""

    generation: int
    slot: int | float
    fitness: float
    prompt: int | None = 0
    detail: str = ""
    kind: str = "candidate"


@dataclass(frozen=True, kw_only=True)
class End:
    """A last line."""

    generation: int
    best: float | None
    kind: str = "generation"


FIRST, SECOND, LAST = (
    Slot(generation=0, slot=0, fitness=0.25, prompt=None),
    Slot(generation=0, slot=1, fitness=0.1 + 0.2, detail="zwölf\u2028Zeilen\r\n"),
    End(generation=0, best=0.25),
)

LINES: list[object] = [Header(schema=1, config={"seed": 0}), FIRST, SECOND, LAST]

ENTRIES = [written(line) for line in LINES]


def kind_of(entry: Mapping[str, Any]) -> type[object] | None:
    """Return the class of a line."""
    return {"run": Header, "candidate": Slot, "generation": End}.get(str(entry.get("kind")))


def read_ledger(path: Path) -> Sealed[object]:
    """Read a ledger of such lines."""
    return read_lines(path, kind_of)


def write_all(path: Path | None, lines: Sequence[object] = LINES) -> str:
    """Commit lines to a ledger; return its digest."""
    with Ledger() if path is None else Ledger.open(path, kind_of) as ledger:
        for line in lines:
            ledger.commit(line)
        return ledger.digest


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return a ledger of four lines."""
    write_all(tmp_path / "ledger.jsonl")
    return tmp_path / "ledger.jsonl"


def test_digest_chains() -> None:
    """Each line's hash covers its entry and the hash before it; published digests stay valid as long as this one."""
    assert write_all(None, []) == GENESIS == "0" * 64
    assert write_all(None) == "1b2491d86dfd2bbc3505b02e7bbab2517984ff2947d50811143beb1805f1ab69"
    first = content_hash({**ENTRIES[0], "previous": GENESIS})
    second = content_hash({**ENTRIES[1], "previous": first})
    assert write_all(None, LINES[:2]) == second
    assert seal(ENTRIES[1], first) == ({**ENTRIES[1], "previous": first, "hash": second}, second)


@given(st.permutations(LINES))
def test_order_of_lines_enters_the_digest(lines: list[object]) -> None:
    """The same lines in another order make another run."""
    assert (write_all(None, lines) == write_all(None)) == (lines == LINES)


def test_lines_come_back_as_committed(path: Path) -> None:
    """Exact to the last bit and character, at once, and as they are sealed together; a missing file has none."""
    standing = read_ledger(path)
    assert list(standing.lines) == LINES
    assert standing.digest == standing.hashes[-1] == write_all(None)
    assert sealed_text(LINES) == (path.read_text(encoding="utf-8"), standing.digest)
    new = path.with_name("new.jsonl")
    assert read_ledger(new) == Sealed()
    with Ledger.open(new, kind_of) as ledger:
        ledger.commit(LINES[0])
        assert read_ledger(new).lines == (LINES[0],)


def test_resumed_run_equals_uninterrupted_run(path: Path, tmp_path: Path) -> None:
    """A run stopped between any two lines, or finished, and computed again ends in the same bytes and digest."""
    for stop in range(len(LINES) + 1):
        resumed = tmp_path / f"stopped-after-{stop}.jsonl"
        write_all(resumed, LINES[:stop])
        with Ledger.open(resumed, kind_of) as ledger:
            assert (ledger.recorded, ledger.committed) == (stop, 0)
        assert write_all(resumed) == write_all(None)
        assert resumed.read_bytes() == path.read_bytes()


def test_run_killed_at_any_byte_resumes_to_the_same_bytes(path: Path, tmp_path: Path) -> None:
    """A last line torn by a crash is dropped, and written again."""
    whole = path.read_bytes()
    for length in range(0, len(whole), 7):
        torn = tmp_path / "torn.jsonl"
        torn.write_bytes(whole[:length])
        assert len(read_ledger(torn).lines) == whole[:length].count(b"\n")
        write_all(torn)
        assert torn.read_bytes() == whole


@pytest.mark.parametrize("step", [7, pytest.param(1, marks=pytest.mark.slow)], ids=["every byte", "every bit"])
def test_any_flipped_bit_of_a_ledger_is_refused_or_cuts_it(step: int, tmp_path: Path) -> None:
    """No bit of a line can change unseen; without its last line feed a ledger is one that was torn there."""
    lines = (Header(config={}), FIRST, LAST)
    write_all(tmp_path / "ledger.jsonl", lines)
    whole = (tmp_path / "ledger.jsonl").read_bytes()
    flipped = tmp_path / "flipped.jsonl"
    refusals: list[RunError] = []
    places = range(0, 8 * len(whole), step)
    for place in places:
        data = bytearray(whole)
        data[place // 8] ^= 1 << place % 8
        flipped.write_bytes(data)
        try:
            lines_read = read_ledger(flipped).lines
        except RunError as error:
            refusals.append(error)
        else:
            assert lines_read == lines[:-1]
    assert all(re.search(r"line [123]", error.place) for error in refusals)
    assert len(refusals) == len([place for place in places if place // 8 < len(whole) - 1])


@pytest.mark.parametrize("room", [0, 1, 100, 300, 500])
def test_full_disk_costs_only_the_line_that_did_not_fit(room: int, path: Path, tmp_path: Path) -> None:
    """The message names the file and what to do; with room again, the same bytes come about."""
    full = tmp_path / "full.jsonl"
    with largest_file(room), refused(RunError, place="full.jsonl", got="File too large", remedy="make room"):
        write_all(full)
    assert len(read_ledger(full).lines) == path.read_bytes()[:room].count(b"\n")
    write_all(full)
    assert full.read_bytes() == path.read_bytes()


@pytest.mark.parametrize(
    ("index", "line", "fields"),
    [
        (
            0,
            Header(schema=1, config={"seed": 1}),
            {"place": "the run's header, config.seed", "expected": "0 as recorded", "got": "1"},
        ),
        (
            1,
            replace(FIRST, fitness=0.5),
            {"place": "generation 0, slot 0, fitness", "expected": "0.25 as recorded", "got": "0.5"},
        ),
        (
            2,
            replace(SECOND, fitness=0.3),
            {"place": "generation 0, slot 1, fitness", "expected": "0.30000000000000004", "got": "0.3"},
        ),
        (3, replace(LAST, best=0.2), {"place": "generation 0, best", "expected": "0.25 as recorded", "got": "0.2"}),
        (1, replace(FIRST, prompt=0), {"place": "slot 0, prompt", "expected": "null as recorded", "got": "null"}),
        (1, replace(FIRST, slot=0.0), {"place": "slot", "expected": "0 as recorded", "got": "0.0"}),
        (
            1,
            replace(FIRST, detail="x" * 300),
            {"place": "slot 0, detail", "expected": "null as recorded", "got": "x" * 196 + "..."},
        ),
    ],
)
def test_divergence_names_generation_slot_and_field(
    index: int, line: object, fields: dict[str, str], path: Path
) -> None:
    """The message leads to the first decision that came out otherwise; the file stays as it was."""
    before = path.read_bytes()
    with Ledger.open(path, kind_of) as ledger:
        for earlier in LINES[:index]:
            ledger.commit(earlier)
        with refused(DivergenceError, **fields):
            ledger.commit(line)
    assert path.read_bytes() == before


def test_ledger_without_a_file_is_compared_with_recorded_lines(path: Path) -> None:
    """A replay compares with what was read, and writes nothing."""
    ledger = Ledger(read_ledger(path))
    ledger.commit(LINES[0])
    with refused(DivergenceError, place="slot"):
        ledger.commit(replace(FIRST, slot=5))


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_edited_line_is_refused_with_its_number(number: int, path: Path) -> None:
    """A line that was edited, even the last, is named; both reading and resuming refuse it, and a gap, too."""
    whole = path.read_bytes()
    lines = path.read_text(encoding="utf-8").split("\n")
    entry = json.loads(lines[number - 1])
    lines[number - 1] = canonical({**entry, "hash": "0" * 64})
    path.write_text("\n".join(lines), encoding="utf-8")
    with refused(RunError, place=f"ledger.jsonl, line {number}"):
        read_ledger(path)
    with refused(RunError, place=f"ledger.jsonl, line {number}"):
        Ledger.open(path, kind_of)
    gapped = b"".join(line for at, line in enumerate(whole.splitlines(keepends=True), start=1) if at != number)
    path.write_bytes(gapped)
    if number < len(LINES):
        with refused(RunError, place=f"line {number}", expected="a line that matches its hash", got="edited"):
            read_ledger(path)


@pytest.mark.parametrize("text", [b"{", b"[]", b"null", b"\xff", b"", b'{"x": NaN}'])
def test_damaged_line_is_refused_with_its_number(text: bytes, path: Path) -> None:
    """A whole line that is not a JSON object is damage, not a torn end."""
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([lines[0], text + b"\n", *lines[2:]]))
    with refused(RunError, place="ledger.jsonl, line 2"):
        read_ledger(path)


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_nan_is_refused(number: float, path: Path) -> None:
    """No line can hold NaN or infinity, and the refused one leaves no trace."""
    before = path.read_bytes()
    with Ledger.open(path, kind_of) as ledger, pytest.raises(ValueError, match="not JSON compliant"):
        ledger.commit(replace(FIRST, fitness=number))
    assert path.read_bytes() == before
