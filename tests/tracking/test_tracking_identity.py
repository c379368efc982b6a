"""A folder has one id, whoever asks for it first; what cannot be written to has none, and no id enters a bundle."""

import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import pytest

from tacevo.cli.app import main
from tacevo.errors import RunError
from tacevo.tracking.identity import FILE, folder_id


def test_id_stays_under_a_new_name(tmp_path: Path) -> None:
    """Asked again, and after a rename, a folder has the id that it had; nothing else is left beside it."""
    (tmp_path / "a").mkdir()
    first = folder_id(tmp_path / "a")
    assert first is not None
    assert folder_id(tmp_path / "a") == first
    (tmp_path / "a").rename(tmp_path / "b")
    assert folder_id(tmp_path / "b") == first
    assert os.listdir(tmp_path / "b") == [FILE]


def test_folders_have_ids_of_their_own(tmp_path: Path) -> None:
    """Equal content and equal names make no equal ids."""
    for name in ("a/run", "b/run"):
        (tmp_path / name).mkdir(parents=True)
    assert folder_id(tmp_path / "a" / "run") != folder_id(tmp_path / "b" / "run")


def test_all_who_ask_at_once_are_told_one_id(tmp_path: Path) -> None:
    """Without any lock the first id that lands is everybody's: round for round, all are told the same."""
    barrier = Barrier(8)

    def ask(folder: Path) -> str | None:
        barrier.wait()
        return folder_id(folder)

    with ThreadPoolExecutor(8) as pool:
        for number in range(20):
            folder = tmp_path / str(number)
            folder.mkdir()
            assert len(set(pool.map(ask, [folder] * 8))) == 1


def test_folder_that_cannot_be_written_to_has_no_id() -> None:
    """A file system that takes no file, not even from root, is no error."""
    assert folder_id(Path("/sys")) is None


def test_folder_that_is_missing_is_not_taken_for_a_read_only_one(tmp_path: Path) -> None:
    """Only what a disk refuses for good is passed over; anything else could make a second run of one."""
    with pytest.raises(FileNotFoundError):
        folder_id(tmp_path / "missing")


@pytest.mark.parametrize("content", [b"", b"0123", b"\xff" * 33, b"'; drop table runs --\n"])
def test_damaged_id_is_told_of(content: bytes, tmp_path: Path) -> None:
    """No id is made of what is none."""
    (tmp_path / FILE).write_bytes(content)
    with pytest.raises(RunError, match="is damaged: expected 32 hex digits"):
        folder_id(tmp_path)


def test_id_enters_no_bundle(published: Path, tmp_path: Path) -> None:
    """A run with an id is published to the same bytes as before it had one."""
    shutil.copytree(published / "run", tmp_path / "run")
    assert folder_id(tmp_path / "run") is not None
    assert main(["publish", str(tmp_path / "run"), "-o", str(tmp_path / "run.zip"), "--author", "A. Nyone"]) == 0
    assert (tmp_path / "run.zip").read_bytes() == (published / "run.zip").read_bytes()
