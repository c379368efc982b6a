"""Promise: `tacevo cache` tells what lies in the stores, names every entry that is not sound, and changes nothing."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tacevo.cli.app import main
from tacevo.records import ChatMessage, Completion, Delivery, Price, Request, to_json
from tacevo.storage.listing import describe_entries, verify
from tacevo.storage.store import Store

HALF = Price(input_usd=1.0, output_usd=2.0, dated="2026-11-21", factor=0.5)


def request(draw: int, model: str = "claude-x") -> Request:
    """Make a request."""
    messages = (ChatMessage(role="user", content="Widen it."),)
    return Request(model=model, system="s", messages=messages, temperature=0.5, max_tokens=9, draw=draw)


def answer(price: Price | None = HALF) -> Completion:
    """Make an answer of a million tokens in and out."""
    return Completion(
        text="class A: ...",
        model="claude-x-dated",
        stop_reason="max_tokens",
        input_tokens=1_000_000,
        output_tokens=1_000_000,
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


@pytest.fixture
def entry(root: Path) -> Path:
    """Give the file of the first completion."""
    store = Store(root, "completions")
    return store.path(store.key(to_json(request(1))))


def described(root: Path) -> str:
    """Describe all entries."""
    return describe_entries(root, sorted(root.rglob("*.json")))


def test_entries_are_counted_by_kind(root: Path, entry: Path) -> None:
    """Files, tokens and dollars, by hand; damage is told, and is no answer to be paid again."""
    told = described(root)
    assert told.startswith("4 files of 0.0 MB (completions 3, probes 1; of models 3 answers, 3,000,000 + 3,000,000 ")
    assert "3.00 USD without the 1 answer of unknown price, to be paid again)" in told
    entry.write_text("{")
    assert "probes 1, 1 of them damaged; of models 2 answers" in described(root)


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
    damage: Callable[[Path], object], words: str, root: Path, entry: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What a store does not accept, or would not find; the line names the file."""
    damage(entry)
    (problem,) = verify(root)[0]
    assert words in problem
    assert problem.startswith(str(root / "completions"))
    assert main(["cache", "verify", "--store", str(root)]) == 1
    assert capsys.readouterr().out.endswith("3 of 4 entries are sound\n")


@pytest.mark.parametrize(
    ("asked", "said"),
    [({"of": "something else"}, {"x": 1}), ({"model": 5}, to_json(answer())), ({"model": "m"}, "text")],
)
def test_completion_that_is_none_is_named(asked: Any, said: Any, root: Path) -> None:
    """A sound entry among the completions that is not a completion stops no command."""
    Store(root, "completions").write(asked, said)
    (problem,) = verify(root)[0]
    assert "; delete it" in problem
    assert "1 of them damaged" in described(root)


def test_missing_store_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A directory that is not there is the user's mistake, and is not made."""
    assert main(["cache", "verify", "--store", str(tmp_path / "nowhere")]) == 2
    assert "expected the directory of stores; got a path that is not one; name it by --store" in capsys.readouterr().err
    assert not (tmp_path / "nowhere").exists()
