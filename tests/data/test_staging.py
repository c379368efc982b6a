"""A staged directory is whole or absent, made by one process at a time, and leaves nothing behind when that fails."""

import errno
import fcntl
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from refusals import refused

from tacevo.data.staging import LOCK, PART, remove_leftovers, reserve, staged
from tacevo.errors import DataError


def test_folder_appears_only_when_it_is_whole(tmp_path: Path) -> None:
    """While it is filled it is hidden; the parent is made on the way, and what a killed process left is not in it."""
    cache = tmp_path / "cache"
    (cache / f".set{PART}").mkdir(parents=True)
    (cache / f".set{PART}" / "old").write_text("half")
    with staged(cache / "set") as stage:
        assert stage is not None
        (stage / "a").write_text("whole")
        assert [path.name for path in cache.iterdir() if not path.name.startswith(".")] == []
    assert [path.name for path in (cache / "set").iterdir()] == ["a"]


def fail(folder: Path, error: BaseException) -> None:
    """Fail while a directory is filled."""
    with staged(folder) as stage:
        assert stage is not None
        (stage / "a").write_text("half")
        raise error


@pytest.mark.parametrize("error", [KeyboardInterrupt("own"), ValueError("own"), OSError(errno.EIO, "own")])
def test_failure_leaves_no_folder(tmp_path: Path, error: BaseException) -> None:
    """After an error nothing of it stays, and the error passes; one of the disk is not called a lack of room."""
    with pytest.raises(type(error), match="own"):
        fail(tmp_path / "set", error)
    assert [path for path in tmp_path.iterdir() if path.is_dir()] == []


def test_who_comes_second_waits_and_has_nothing_to_do(tmp_path: Path) -> None:
    """The second maker is offered no directory, and only once the first one's is whole."""
    offered: list[Path | None] = []
    seen: list[bool] = []

    def second() -> None:
        with staged(tmp_path / "set") as stage:
            offered.append(stage)
            seen.append((tmp_path / "set" / "a").exists())

    with staged(tmp_path / "set") as stage:
        assert stage is not None
        waiting = threading.Thread(target=second)
        waiting.start()
        waiting.join(0.2)
        assert offered == []
        (stage / "a").write_text("whole")
    waiting.join()
    assert (offered, seen) == ([None], [True])


@pytest.mark.parametrize("sweep", [remove_leftovers, lambda parent: fill(parent / "set")])
def test_leftovers_go_and_folders_in_the_making_stay(tmp_path: Path, sweep: Callable[[Path], None]) -> None:
    """Whoever makes or reads another set removes what is hidden and whose lock is free; and nothing else."""
    for name in ("dead", "alive"):
        (tmp_path / f".{name}{PART}").mkdir()
        (tmp_path / f".{name}{PART}" / "images.npy").write_text("half")
    (tmp_path / ".other").mkdir()
    with (tmp_path / f".alive{LOCK}").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        sweep(tmp_path)
    assert {path.name for path in tmp_path.iterdir() if path.is_dir()} - {"set"} == {f".alive{PART}", ".other"}


def fill(folder: Path) -> None:
    """Make a set of nothing."""
    with staged(folder):
        pass


@contextmanager
def as_another_user() -> Iterator[None]:
    """Act as one whom file permissions bind, which they do not the superuser."""
    before = os.geteuid()
    if before == 0:
        os.seteuid(65_534)
    try:
        yield
    finally:
        os.seteuid(before)


@pytest.fixture
def shared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a directory that every user may write to, as a relative path, which needs no permission above it."""
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache").chmod(0o777)
    monkeypatch.chdir(tmp_path / "cache")
    return Path()


@pytest.mark.parametrize("mode", [0o000, 0o444])
def test_leftover_of_another_user_is_skipped(shared: Path, mode: int) -> None:
    """In a shared cache a lock that may not be opened or a directory that may not be removed is its owner's affair."""
    left = shared / f".dead{PART}"
    left.mkdir()
    (left / "images.npy").write_text("half")
    left.chmod(0o555)
    (shared / f".dead{LOCK}").touch(mode)
    with as_another_user(), staged(shared / "set") as stage:
        assert stage is not None
    assert (shared / "set").is_dir()
    assert (left / "images.npy").exists()
    left.chmod(0o755)


def test_lock_file_of_another_user_is_obeyed(shared: Path) -> None:
    """Who made a data set first owns its lock file; others lock it all the same, and are not refused."""
    (shared / f".set{LOCK}").touch(0o444)
    waits = []
    with (shared / f".set{LOCK}").open("rb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)

        def release() -> None:
            waits.append("waited")
            fcntl.flock(lock, fcntl.LOCK_UN)

        with as_another_user(), staged(shared / "set", release) as stage:
            assert stage is not None
    assert waits == ["waited"]


def test_own_part_that_may_not_be_removed_is_named(shared: Path) -> None:
    """Nothing is filled into what another user's killed process left."""
    left = shared / f".set{PART}"
    left.mkdir()
    (left / "old").write_text("half")
    left.chmod(0o555)
    remedy = f"ask user {os.geteuid()} to remove it"
    with refused(DataError, place=f".set{PART}", remedy=remedy), as_another_user():
        fill(shared / "set")
    left.chmod(0o755)


def test_parent_that_is_a_file_is_refused(tmp_path: Path) -> None:
    """The message names what cannot be written to."""
    (tmp_path / "file").write_text("")
    with refused(DataError, place="/file", got="cannot be written to"):
        fill(tmp_path / "file" / "set")


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_disk_that_fills_later_is_told_too(tmp_path: Path, number: int) -> None:
    """The small files beside the images can be what is too much."""
    with refused(DataError, place=str(tmp_path), got="the disk is full"):
        fail(tmp_path / "set", OSError(number, "No space left"))


def test_other_failures_of_a_file_pass_unchanged(tmp_path: Path) -> None:
    """Not every error means that room is missing."""
    (tmp_path / "images").touch()
    with pytest.raises(OSError, match="Bad file descriptor"), (tmp_path / "images").open("rb") as file:
        reserve(file, 10)
