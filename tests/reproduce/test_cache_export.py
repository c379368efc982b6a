"""Promise: an export holds exactly what a run needs, byte for byte the same; an import writes all of it or nothing."""

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from refusals import refused
from smallest import Once

from tacevo.cli.app import main
from tacevo.errors import StoreError
from tacevo.reproduce.entry_files import import_file
from tacevo.storage.entries import ReadBudget, pack, unpack
from tacevo.storage.store import SEARCHED, Entry, Store


@pytest.fixture(scope="session")
def exported(published: Path, once: Once) -> Path:
    """Return a directory with a run without a study, its stores (with a foreign entry), and its export."""

    def export(folder: Path) -> None:
        for name in ("run", "cache"):
            shutil.copytree(published / name, folder / name, ignore=shutil.ignore_patterns("studies", "arrays"))
        Store(folder / "cache", "completions").write({"of": "another run"}, {"x": 1})
        command = ["cache", "export", str(folder / "run"), "--store", str(folder / "cache")]
        assert main([*command, "-o", str(folder / "run.jsonl.xz")]) == 0

    return once("exported", export)


def entries_of(file: Path) -> list[Entry]:
    """Read the entries of an export."""
    return list(unpack(file, ReadBudget(file, file.stat().st_size)))


def import_refused(entries: Sequence[Entry], tmp_path: Path, expected: str) -> None:
    """Try an import, and check that it says so and writes nothing."""
    file, root = tmp_path / "evil.jsonl.xz", tmp_path / "cache"
    file.write_bytes(pack(entries))
    before = {path: path.read_bytes() for path in root.rglob("*.json")}
    with refused(StoreError, expected=expected):
        import_file(file, root)
    assert {path: path.read_bytes() for path in root.rglob("*.json")} == before


def test_kinds_are_those_that_a_search_keeps(exported: Path) -> None:
    """A store that a search begins to use must be listed, or nobody verifies or exports it; images are made anew."""
    assert {path.name for path in (exported / "cache").iterdir()} == {*SEARCHED, "data"}


def test_export_holds_what_the_run_needs_and_nothing_else(exported: Path) -> None:
    """Every entry of this run's stores, and not the one of another run."""
    cache = exported / "cache"
    needed = {path.stem for kind in SEARCHED for path in (cache / kind).glob("*/*.json")}
    needed.remove(Store(cache, "completions").key({"of": "another run"}))
    assert {entry.key for entry in entries_of(exported / "run.jsonl.xz")} == needed


def test_import_into_nothing_is_enough_for_a_replay(exported: Path, tmp_path: Path) -> None:
    """What was exported is what a replay reads, elsewhere."""
    written, standing, passed_over = import_file(exported / "run.jsonl.xz", tmp_path / "cache")
    assert (written > 5, standing, passed_over) == (True, 0, 0)
    assert main(["replay", str(exported / "run"), "--store", str(tmp_path / "cache")]) == 0
    assert import_file(exported / "run.jsonl.xz", tmp_path / "cache") == (0, written, 0)


def test_export_has_the_same_bytes_from_anywhere(exported: Path, place: Path) -> None:
    """Another day, directory and set of stores give the same file."""
    shutil.copytree(exported / "run", place / "elsewhere")
    import_file(exported / "run.jsonl.xz", place / "stores")
    assert main(["cache", "export", "elsewhere", "-o", "again.jsonl.xz", "--store", "stores"]) == 0
    assert (place / "again.jsonl.xz").read_bytes() == (exported / "run.jsonl.xz").read_bytes()


def test_run_that_its_stores_do_not_give_is_not_exported(exported: Path, tmp_path: Path) -> None:
    """An export begins with a replay, and leaves no file where that fails."""
    shutil.copytree(exported / "run", tmp_path / "run")
    store = ["--store", str(tmp_path / "empty")]
    assert main(["cache", "export", str(tmp_path / "run"), "-o", str(tmp_path / "run.jsonl.xz"), *store]) == 2
    assert not (tmp_path / "run.jsonl.xz").exists()


@pytest.mark.parametrize(
    ("asked", "said", "expected"),
    [
        ({"model": "m"}, {"text": "not a completion"}, "a value"),
        ({"model": 5}, None, "text"),
        (["m"], None, "an object"),
    ],
)
def test_completion_that_cannot_be_read_is_refused(
    asked: Any, said: Any, expected: str, exported: Path, tmp_path: Path
) -> None:
    """What `verify` would condemn does not come in: the last entry is verified before the first is written."""
    entries = entries_of(exported / "run.jsonl.xz")
    sound = next(entry for entry in entries if entry.kind == "completions")
    evil = replace(sound, request=asked, answer=said or sound.answer)
    import_refused([*entries, evil], tmp_path, expected)


def test_other_answer_in_the_store_is_kept(exported: Path, tmp_path: Path) -> None:
    """A conflict is the user's to decide; nothing is written over, and nothing beside."""
    entries = entries_of(exported / "run.jsonl.xz")
    mine = next(entry for entry in entries if entry.kind == "completions")
    answer: Any = mine.answer
    Store(tmp_path / "cache", "completions").write(mine.request, {**answer, "text": "mine"})
    import_refused(entries, tmp_path, "the answer that")


def test_link_in_the_store_is_not_followed(exported: Path, tmp_path: Path) -> None:
    """A directory of the store that leads elsewhere is refused."""
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache" / "completions").symlink_to(tmp_path)
    import_refused(entries_of(exported / "run.jsonl.xz"), tmp_path, "a file or a new place in")


def test_foreign_file_is_refused(tmp_path: Path) -> None:
    """The message says what was expected."""
    (tmp_path / "foreign").write_bytes(b"not an export")
    with refused(StoreError, place="foreign", expected="`tacevo cache export`"):
        import_file(tmp_path / "foreign", tmp_path / "cache")


def test_commands_say_what_they_did(exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The numbers of entries that were written and that stood there."""
    for written in (True, False):
        assert main(["cache", "import", str(exported / "run.jsonl.xz"), "--store", str(tmp_path / "cache")]) == 0
        out = capsys.readouterr().out
        assert out.startswith("0 entries written") != written
