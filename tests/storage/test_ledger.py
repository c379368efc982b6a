"""Promise: the digest stands for every decision; a killed run goes on where it was; no change goes unnoticed."""

import dataclasses
import json
import re
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacevo.errors import DivergenceError, RunError
from tacevo.records import Json
from tacevo.storage.canonical import canonical, content_hash
from tacevo.storage.ledger import GENESIS, Ledger, read_ledger, seal

ENTRIES: list[dict[str, Json]] = [
    {"kind": "run", "schema": 1, "config": {"seed": 0}},
    {"kind": "candidate", "generation": 0, "slot": 0, "fitness": 0.25, "prompt": None},
    {"kind": "candidate", "generation": 0, "slot": 1, "fitness": 0.1 + 0.2, "detail": "zwölf\u2028Zeilen\r\n"},
    {"kind": "generation", "generation": 0, "best": 0.25},
]


def write_all(path: Path | None, entries: list[dict[str, Json]] = ENTRIES) -> str:
    """Commit entries to a ledger; return its digest."""
    with Ledger(path) as ledger:
        for entry in entries:
            ledger.commit(entry)
        return ledger.digest


@dataclasses.dataclass(frozen=True)
class Change:
    """An entry committed again with a change, and where the message must find it."""

    index: int
    entry: dict[str, Json]
    message: str


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Give a ledger of four lines."""
    write_all(tmp_path / "ledger.jsonl")
    return tmp_path / "ledger.jsonl"


def test_empty_ledger_has_the_genesis_digest(tmp_path: Path) -> None:
    """Before the first line the digest is 64 zeros."""
    assert write_all(tmp_path / "ledger.jsonl", []) == GENESIS == "0" * 64


def test_digest_chains() -> None:
    """Each line's hash covers its entry and the hash before it; the digest is the last of them."""
    first = content_hash({**ENTRIES[0], "previous": GENESIS})
    second = content_hash({**ENTRIES[1], "previous": first})
    assert write_all(None, ENTRIES[:2]) == second
    assert seal(ENTRIES[1], first) == {**ENTRIES[1], "previous": first, "hash": second}


def test_digest_is_golden() -> None:
    """Published digests stay valid only as long as this one does."""
    assert write_all(None) == "1b2491d86dfd2bbc3505b02e7bbab2517984ff2947d50811143beb1805f1ab69"


@given(st.permutations(ENTRIES))
def test_order_of_lines_enters_the_digest(entries: list[dict[str, Json]]) -> None:
    """The same entries in another order make another run."""
    assert (write_all(None, entries) == write_all(None)) == (entries == ENTRIES)


def test_lines_come_back_as_committed(path: Path) -> None:
    """Reading gives every entry with its links, exact to the last bit and character."""
    lines = read_ledger(path)
    plain = [{key: line[key] for key in line if key not in {"previous", "hash"}} for line in lines]
    assert plain == ENTRIES
    assert [line["previous"] for line in lines] == [GENESIS, *(line["hash"] for line in lines[:-1])]


def test_committed_line_is_on_disk_at_once(tmp_path: Path) -> None:
    """A line can be read before the ledger is closed."""
    with Ledger(tmp_path / "ledger.jsonl") as ledger:
        line = ledger.commit(ENTRIES[0])
        assert read_ledger(tmp_path / "ledger.jsonl") == (line,)


def test_resumed_run_equals_uninterrupted_run(path: Path, tmp_path: Path) -> None:
    """A run stopped between any two lines and computed again ends in the same bytes."""
    for stop in range(len(ENTRIES) + 1):
        resumed = tmp_path / f"stopped-after-{stop}.jsonl"
        write_all(resumed, ENTRIES[:stop])
        write_all(resumed)
        assert resumed.read_bytes() == path.read_bytes()


def test_run_killed_at_any_byte_resumes_to_the_same_bytes(path: Path, tmp_path: Path) -> None:
    """A last line torn by a crash is dropped, and written again."""
    whole = path.read_bytes()
    for length in range(0, len(whole), 7):
        torn = tmp_path / "torn.jsonl"
        torn.write_bytes(whole[:length])
        assert len(read_ledger(torn)) == whole[:length].count(b"\n")
        write_all(torn)
        assert torn.read_bytes() == whole


def small_ledger(path: Path) -> list[dict[str, Json]]:
    """Write a ledger of three short lines; give them."""
    write_all(path, [{"kind": "run"}, {"slot": 0, "loss": 0.25}, {"best": None}])
    return list(read_ledger(path))


def test_ledger_cut_at_any_byte_keeps_its_whole_lines(tmp_path: Path) -> None:
    """Truncated anywhere, a ledger is the lines before the cut and nothing else."""
    lines = small_ledger(tmp_path / "ledger.jsonl")
    whole = (tmp_path / "ledger.jsonl").read_bytes()
    cut = tmp_path / "cut.jsonl"
    for length in range(len(whole) + 1):
        cut.write_bytes(whole[:length])
        assert list(read_ledger(cut)) == lines[: whole[:length].count(b"\n")]


def test_any_flipped_bit_of_a_ledger_is_refused_or_cuts_it(tmp_path: Path) -> None:
    """No bit of a line can change unseen; without its last line feed a ledger is one that was torn there."""
    lines = small_ledger(tmp_path / "ledger.jsonl")
    whole = (tmp_path / "ledger.jsonl").read_bytes()
    flipped = tmp_path / "flipped.jsonl"
    refused = 0
    for place in range(8 * len(whole)):
        data = bytearray(whole)
        data[place // 8] ^= 1 << place % 8
        flipped.write_bytes(data)
        found = lines_or_refusal(flipped)
        if isinstance(found, str):
            refused += 1
            assert re.search(r"line [123] (is not JSON|does not match its hash)", found)
        else:
            assert found == lines[:-1]
    assert refused == 8 * (len(whole) - 1)


def lines_or_refusal(path: Path) -> list[dict[str, Json]] | str:
    """Read a ledger; give its lines, or the words with which it is refused."""
    try:
        return list(read_ledger(path))
    except RunError as error:
        return str(error)


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Let no file grow beyond a size, as on a disk that is full: what fits is written, then the system refuses."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("room", [0, 1, 100, 300, 500])
def test_full_disk_costs_only_the_line_that_did_not_fit(room: int, path: Path, tmp_path: Path) -> None:
    """The message names the file and what to do; with room again, the same bytes come about."""
    full = tmp_path / "full.jsonl"
    with (
        largest_file(room),
        pytest.raises(RunError, match=r"full.jsonl cannot be written: File too large; .*Make room"),
    ):
        write_all(full)
    assert len(read_ledger(full)) == path.read_bytes()[:room].count(b"\n")
    write_all(full)
    assert full.read_bytes() == path.read_bytes()


def test_resuming_counts_what_stood_there(path: Path) -> None:
    """`recorded` is what was found, `committed` what this session said."""
    with Ledger(path) as ledger:
        ledger.commit(ENTRIES[0])
        assert (ledger.recorded, ledger.committed) == (4, 1)


def test_commit_where_a_line_stands_compares(path: Path) -> None:
    """Computing a finished run again changes no byte, and gives its digest."""
    before = path.read_bytes()
    assert write_all(path) == read_ledger(path)[-1]["hash"]
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "change",
    [
        Change(
            0,
            {**ENTRIES[0], "config": {"seed": 1}},
            r"the run's header: field 'config.seed' was recorded as 0 and is now 1",
        ),
        Change(1, {**ENTRIES[1], "fitness": 0.5}, r"generation 0, slot 0: field 'fitness' was recorded as 0.25 and is"),
        Change(2, {**ENTRIES[2], "fitness": 0.3}, r"generation 0, slot 1: field 'fitness' was recorded as 0.30000000"),
        Change(3, {**ENTRIES[3], "best": 0.2}, r"generation 0: field 'best' was recorded as 0.25 and is now 0.2"),
        Change(1, {k: v for k, v in ENTRIES[1].items() if k != "prompt"}, r"slot 0: field 'prompt' was recorded as"),
        Change(1, {**ENTRIES[1], "slot": 0.0}, r"field 'slot' was recorded as 0 and is now 0.0"),
        Change(3, {**ENTRIES[3], "a": "x" * 300}, r"field 'a' was recorded as null and is now \"x{196}\.\.\.$"),
    ],
)
def test_divergence_names_generation_slot_and_field(change: Change, path: Path) -> None:
    """The message leads to the first decision that came out otherwise; the file stays as it was."""
    before = path.read_bytes()
    with Ledger(path) as ledger:
        for entry in ENTRIES[: change.index]:
            ledger.commit(entry)
        with pytest.raises(DivergenceError, match=change.message):
            ledger.commit(change.entry)
    assert path.read_bytes() == before


def test_ledger_in_memory_is_held_against_recorded_lines(path: Path) -> None:
    """A replay compares with what was read, and writes nothing."""
    ledger = Ledger(None, recorded=read_ledger(path))
    ledger.commit(ENTRIES[0])
    with pytest.raises(DivergenceError, match="field 'slot'"):
        ledger.commit({**ENTRIES[1], "slot": 5})


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_edited_line_is_refused_with_its_number(number: int, path: Path) -> None:
    """A line that was edited, even the last, is named; both reading and resuming refuse it."""
    lines = path.read_text(encoding="utf-8").split("\n")
    entry = json.loads(lines[number - 1])
    lines[number - 1] = canonical({**entry, "kind": "edited"})
    path.write_text("\n".join(lines), encoding="utf-8")
    for refuse in (read_ledger, Ledger):
        with pytest.raises(RunError, match=rf"ledger.jsonl, line {number} does not match its hash"):
            refuse(path)


def test_line_that_was_taken_out_is_noticed(path: Path) -> None:
    """The line after a gap no longer links to the one before it."""
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([lines[0], *lines[2:]]))
    with pytest.raises(RunError, match="line 2 does not match its hash"):
        read_ledger(path)


@pytest.mark.parametrize("text", [b"{", b"[]", b"null", b"\xff", b"", b'{"x": NaN}'])
def test_damaged_line_is_refused_with_its_number(text: bytes, path: Path) -> None:
    """A whole line that is no JSON object is damage, not a torn end."""
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([lines[0], text + b"\n", *lines[2:]]))
    with pytest.raises(RunError, match=r"ledger.jsonl, line 2 (is not JSON|does not match)"):
        read_ledger(path)


def test_missing_ledger_is_an_error(tmp_path: Path) -> None:
    """Reading a ledger that is not there says what to give."""
    with pytest.raises(RunError, match="is missing; give the folder of a run"):
        read_ledger(tmp_path / "ledger.jsonl")


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_nan_is_refused(number: float, path: Path) -> None:
    """No line can hold NaN or infinity, and the refused one leaves no trace."""
    before = path.read_bytes()
    with Ledger(path) as ledger, pytest.raises(ValueError, match="not JSON compliant"):
        ledger.commit({"kind": "candidate", "fitness": number})
    assert path.read_bytes() == before
