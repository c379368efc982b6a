"""Directories that are whole or absent: filled out of sight, flushed to the disk, then renamed.

Promises: one process at a time makes a directory, and others report it and wait; what a killed process left is
removed by the next one that makes or reads anything there and may remove it; a disk without room is an error before
anything is written to it.
What it does not: it needs a file system on which `flock` works across the processes that share it, and on Windows,
which has no `flock`, that no other process makes the directory at the same time.
"""

import errno
import os
import shutil
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from tacevo.errors import DataError
from tacevo.storage.files import HAS_LOCKS, flock, sync

#: A directory in the making, and the file that its maker holds locked; both are hidden, and the latter stays.
PART, LOCK = ".tacevo-part", ".tacevo-lock"

REMEDY = "make room there, choose a directory on another disk (store.root), or lower data.image_size"

#: The system's errors for missing space: on the disk, for this user, for one file.
NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})


@contextmanager
def staged(directory: Path, waiting: Callable[[], None] | None = None) -> Iterator[Path | None]:
    """Offer a hidden sibling to fill; on success it becomes `directory` in one step, else it is removed.

    The parent is made where it is absent. `waiting` is called where another process makes the directory, before we
    wait for it.

    Yields:
        The directory to fill; None if another process has filled it first.

    Raises:
        DataError: the parent directory cannot be written to, or holds a part of the directory that we may not remove.
    """
    stage = _hidden(directory, PART)
    try:
        directory.parent.mkdir(parents=True, exist_ok=True)
        lock = _open_lock(_hidden(directory, LOCK))
    except OSError as error:
        got = f"a directory that cannot be written to ({error.strerror})"
        raise DataError(got, place=str(directory.parent), remedy="choose another directory") from error
    with lock:
        if HAS_LOCKS and not flock(lock.fileno()):
            if waiting is not None:
                waiting()
            flock(lock.fileno(), wait=True)
        if directory.is_dir():
            yield None
            return
        remove_leftovers(directory.parent)
        _clear(stage)
        try:
            stage.mkdir()
            yield stage
            _publish(stage, directory)
        except OSError as error:
            if error.errno in NO_ROOM:
                raise DataError(
                    f"the disk is full ({error.strerror})", place=str(directory.parent), remedy=REMEDY
                ) from error
            raise
        finally:
            shutil.rmtree(stage, ignore_errors=True)


@contextmanager
def new_directory(out: Path) -> Iterator[Path]:
    """Offer a hidden sibling to fill; on success it becomes `out` in one step, else it is removed.

    Unlike with `staged`, no lock file stays behind: this is the user's own directory.

    Raises:
        OSError: the parent cannot be written to; or `out` is there at the end, and is not an empty directory; or the
            disk does not take it, and then `out` may stand.
    """
    stage = out.with_name(f".{out.name}-{uuid.uuid4().hex[:12]}")
    stage.mkdir(parents=True)
    try:
        yield stage
        _publish(stage, out)
    finally:
        shutil.rmtree(stage, ignore_errors=True)


def reserve(file: BinaryIO, size: int) -> None:
    """Reserve the bytes of a file now, because a full disk under a memory map would kill the process.

    The file is open for writing, in a directory that `staged` offers.

    Raises:
        DataError: the space is missing; the error names the directory and the bytes.
    """
    try:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file.fileno(), 0, size)
        else:  # macOS and Windows
            file.truncate(size)
    except OSError as error:
        if error.errno not in NO_ROOM:
            raise
        folder = Path(file.name).parent.parent
        raise DataError(
            f"{shutil.disk_usage(folder).free:,} ({error.strerror})",
            place=str(folder),
            expected=f"{size:,} free bytes for the images",
            remedy=REMEDY,
        ) from error


def remove_leftovers(parent: Path) -> None:
    """Remove what killed processes left: directories in the making whose lock is free (a maker holds its own)."""
    for stage in parent.glob(f".*{PART}"):
        try:
            with _open_lock(stage.with_suffix(LOCK)) as lock:
                if flock(lock.fileno()):
                    shutil.rmtree(stage, ignore_errors=True)
        except OSError:  # another user owns it
            continue


def _publish(stage: Path, directory: Path) -> None:
    """Flush a filled directory to the disk and give it its name."""
    for file in stage.iterdir():
        sync(file)
    sync(stage)
    stage.rename(directory)  # atomic: a reader sees the whole directory or nothing
    sync(directory.parent)


def _open_lock(path: Path) -> BinaryIO:
    """Open a lock file, made where it is absent; another user's can be read only, which is enough for a lock."""
    try:
        return path.open("ab")
    except PermissionError:
        return path.open("rb")


def _clear(stage: Path) -> None:
    """Remove what a killed process left of this very directory."""
    shutil.rmtree(stage, ignore_errors=True)
    if stage.exists():
        got = "a killed process left this directory, and it cannot be removed"
        raise DataError(got, place=str(stage), remedy=f"ask user {stage.stat().st_uid} to remove it")


def _hidden(directory: Path, suffix: str) -> Path:
    return directory.with_name(f".{directory.name}{suffix}")
