"""Promise: `tacevo cache` tells what lies in the stores, names every entry that is not sound, and changes nothing."""

from pathlib import Path
from typing import Any

import pytest
from refusals import refused

from tacevo.cli.app import main
from tacevo.errors import StoreError
from tacevo.records import Completion, Delivery, Json, Message, Price, Request, to_json
from tacevo.storage.listing import explain, list_stores, verify
from tacevo.storage.store import Store

HALF = Price(input_usd=1.0, output_usd=2.0, dated="2026-11-21", factor=0.5)


def request(draw: int, model: str = "claude-x") -> Request:
    """Make a request."""
    messages = (Message(role="user", content="Widen it."),)
    return Request(model=model, system="s", messages=messages, temperature=0.5, max_tokens=9, draw=draw)


def answer(price: Price | None = HALF) -> Completion:
    """Make an answer of a million tokens in and out."""
    return Completion(
        text="class A: ...",
        model="claude-x-dated",
        stop_reason="max_tokens",
        input_tokens=1_000_000,
        output_tokens=1_000_000,
        dropped=("temperature",),
        delivery=Delivery.batch,
        price=price,
    )


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Give stores with three completions of two models and a probe."""
    completions = Store(tmp_path, "completions")
    for asked in (request(1), request(2), request(3, "llama")):
        completions.write(to_json(asked), to_json(answer(None if asked.model == "llama" else HALF)))
    Store(tmp_path, "probes").write({"source": "a"}, {"profile": "b"})
    return tmp_path


def path_of(root: Path, asked: Request) -> Path:
    """Find a completion's file."""
    key = Store(root, "completions").key(to_json(asked))
    return root / "completions" / key[:2] / f"{key}.json"


def rows(page: str) -> list[list[str]]:
    """Read a table's rows, without its header."""
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines()[2:]]


def test_ls_counts_by_kind_and_model(root: Path) -> None:
    """Entries, sizes, tokens and dollars, by hand; a model without a price has no cost."""
    probe, *completions = sorted(rows(list_stores(root, kind=None, model=None)), reverse=True)
    assert completions == [
        ["completions", "llama", "1", "0.00 MB", "1,000,000", "1,000,000", "price unknown"],
        ["completions", "claude-x", "2", "0.00 MB", "2,000,000", "2,000,000", "3.00 USD"],
    ]
    assert probe == ["probes", "", "1", "0.00 MB", "", "", ""]


def test_commands_print_what_is_found(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of the stores that are named, and by the kind that is."""
    key = path_of(root, request(1)).stem
    assert main(["cache", "ls", "--kind", "probes", "--store", str(root)]) == 0
    assert capsys.readouterr().out == f"{list_stores(root, kind='probes', model=None)}\n"
    assert main(["cache", "explain", key[:8], "--store", str(root)]) == 0
    assert capsys.readouterr().out == f"{explain(root, key)}\n"


@pytest.mark.parametrize(
    ("kind", "model", "found"),
    [
        ("probes", None, ["probes"]),
        (None, "claude", ["completions"]),
        ("completions", None, ["completions", "completions"]),
    ],
)
def test_ls_filters(kind: str | None, model: str | None, found: list[str], root: Path) -> None:
    """By kind, and by a part of a model's name."""
    assert [row[0] for row in rows(list_stores(root, kind=kind, model=model))] == found


def test_ls_of_nothing_says_so(root: Path) -> None:
    """A filter that fits nothing is not an error."""
    assert list_stores(root, kind=None, model="gpt") == f"no such entries in {root}"


def test_ls_counts_damaged_entries_apart(root: Path) -> None:
    """What cannot be read is neither hidden nor counted as an answer."""
    path_of(root, request(1)).write_text("{")
    damaged = next(row for row in rows(list_stores(root, kind=None, model=None)) if row[1] == "(damaged)")
    assert damaged[2:] == ["1", "0.00 MB", "", "", ""]


def test_sound_stores_are_verified(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every entry of every kind is checked; what a killed writer left is not an entry."""
    (root / "probes" / "00").mkdir()
    (root / "probes" / "00" / ".00.json.1-2.part").write_text("{")
    assert verify(root) == ([], 4)
    assert main(["cache", "verify", "--store", str(root)]) == 0
    assert capsys.readouterr().out == "4 of 4 entries are sound\n"


def truncated(path: Path) -> None:
    """Lose the end."""
    path.write_bytes(path.read_bytes()[:-20])


def moved(path: Path) -> None:
    """Put it where nobody looks it up."""
    path.rename(path.parents[1] / path.name)


def unreachable(path: Path) -> None:
    """Leave a link to what is gone."""
    path.unlink()
    path.symlink_to(path.name + ".gone")


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (truncated, "expected JSON"),
        (unreachable, "expected a file that can be read; got No such file"),
        (moved, ".json; move it"),
    ],
)
def test_damage_is_named_and_gives_status_1(
    damage: object, words: str, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What a store does not accept, or would not find; the line names the file."""
    damage(path_of(root, request(1)))  # type: ignore[operator]
    (problem,) = verify(root)[0]
    assert words in problem
    assert problem.startswith(str(root / "completions"))
    assert main(["cache", "verify", "--store", str(root)]) == 1
    assert capsys.readouterr().out.endswith("3 of 4 entries are sound\n")


@pytest.mark.parametrize(
    ("asked", "said"),
    [({"of": "something else"}, {"x": 1}), ({"model": 5}, to_json(answer())), ({"model": "m"}, "text")],
)
def test_completion_that_is_none_is_found(asked: Any, said: Any, root: Path) -> None:
    """A sound entry among the completions that is not a completion is named, and stops no command."""
    Store(root, "completions").write(asked, said)
    (problem,) = verify(root)[0]
    assert "; delete it" in problem
    assert "(damaged)" in list_stores(root, kind=None, model=None)


def test_explain_tells_an_entry_and_its_neighbour(root: Path) -> None:
    """What was asked and answered, and the field in which the nearest other recording differs, with both values."""
    key = Store(root, "completions").key(to_json(request(1)))
    page = explain(root, key[:8].upper())
    assert page.startswith(f"completions {key}: recorded in")
    assert "answered by claude-x-dated (batch, sent without temperature), ended by max_tokens" in page
    assert "1,000,000 + 1,000,000 tokens, 1.50 USD" in page
    assert "it differs in 1 field:\n  draw: recorded 2, here 1" in page


@pytest.mark.parametrize("name", ["a.b", "messages.0", ".", "", "temperature."])
def test_explain_takes_a_field_of_any_name(name: str, root: Path) -> None:
    """A dot in a name leads nowhere else: the field is shown with its own value."""
    asked: dict[str, Json] = {"source": "a", name: "odd"}
    probes = Store(root, "probes")
    probes.write(asked, {"profile": "b"})
    assert f'  {name}: recorded null, here "odd"' in explain(root, probes.key(asked))


def test_entry_that_is_no_completion_is_not_explained(root: Path) -> None:
    """Its checksum is right, but this version cannot read it."""
    Store(root, "completions").write({"model": "m"}, {"text": "no completion"})
    with refused(StoreError, place="answer", remedy="delete it"):
        explain(root, Store(root, "completions").key({"model": "m"}))


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("00000000", "one entry whose key begins with 00000000"),
        ("abc", "at least 4 hexadecimal digits of a key"),
        ("request.json", "at least 4 hexadecimal digits"),
        ("../../etc", "at least 4 hexadecimal digits"),
    ],
)
def test_key_that_names_nothing_is_refused(what: str, words: str, root: Path) -> None:
    """The message says how an entry is named."""
    with refused(StoreError, expected=words):
        explain(root, what)


def test_damaged_entry_is_not_explained(root: Path) -> None:
    """What cannot be believed is named, and nothing of it is shown."""
    path = path_of(root, request(1))
    truncated(path)
    with refused(StoreError, place=str(path), expected="JSON"):
        explain(root, path.stem)


@pytest.mark.parametrize("arguments", [["ls"], ["verify"], ["explain", "abcd"]])
def test_missing_store_is_one_line(arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A directory that is not there is the user's mistake, and is not made."""
    assert main(["cache", *arguments, "--store", str(tmp_path / "nowhere")]) == 2
    assert "expected the directory of stores; got a path that is not one; name it by --store" in capsys.readouterr().err
    assert not (tmp_path / "nowhere").exists()
