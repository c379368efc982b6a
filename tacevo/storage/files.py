"""Files that survive a crash, and locks between processes; a killed process lets go of its locks."""

import contextlib
import errno
import itertools
import os
import re
import secrets
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from tacevo.errors import RunError, StoreError

try:
    import fcntl
except ImportError:  # Windows, where replays and tables are read and written, but nothing is searched
    fcntl = None  # type: ignore[assignment]
HAS_LOCKS = fcntl is not None

#: The number of times that a lock which another process holds is tried again, and the seconds before each.
_PATIENCE, _PAUSE = 20, 0.05

#: A file in the making: hidden beside what it will be, or in a directory above, and locked by its writer.
_PART = re.compile(r"\..+\.[0-9a-f]{16}\.part")

#: The errors of making a directory where a file has its name, or that of one above it.
_IN_THE_WAY = (FileExistsError, NotADirectoryError)

#: The error numbers of `flock` where a file system has no locks.
_NO_LOCKS = {errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK}

#: The error numbers of a second name for a file where a file system has one name a file, or both in one directory only.
_NO_LINKS = {errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EPERM, errno.EINVAL, errno.EXDEV}


@contextlib.contextmanager
def locked(folder: Path, setting: str) -> Iterator[None]:
    """Lock a directory for this process alone; a killed process lets go of it by itself.

    Args:
        folder: made if it is absent.
        setting: what names it, e.g. `run.dir`.

    Raises:
        RunError: another process is at work in it, or it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder / ".lock", os.O_CREAT | os.O_RDWR, 0o666)  # not inherited
    except OSError as error:
        got, expected = f"one that cannot ({error.strerror})", "a directory that can be written to"
        remedy = "move away the file that stands in its place" if isinstance(error, _IN_THE_WAY) else ""
        raise RunError(got, place=f"{setting}={folder}", expected=expected, remedy=remedy) from error
    try:
        if not _flock_soon(handle):
            got, remedy = "another process in it", f"wait for it, or choose another {setting}"
            raise RunError(got, place=f"{setting}={folder}", expected="an idle directory", remedy=remedy)
        yield
    finally:
        os.close(handle)


def _flock_soon(handle: int, *, shared: bool = False) -> bool:
    """Lock as `flock` does; where another process holds the lock, try again for a second.

    `is_in_use` of another process holds it for a moment, to see whether it is free.
    """
    for _ in range(_PATIENCE):
        if flock(handle, shared=shared):
            return True
        time.sleep(_PAUSE)
    return False


def flock(handle: int, *, wait: bool = False, shared: bool = False) -> bool:
    """Lock an open file or directory until it is closed; return False where another process holds it.

    Args:
        handle: of the file or directory.
        wait: for the other process, as long as it takes.
        shared: with others that share it.

    Raises:
        OSError: the file system has no locks, or the system has none.
    """
    if not HAS_LOCKS:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    try:
        fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    return True


@contextlib.contextmanager
def in_use(folder: Path, *, alone: bool = False) -> Iterator[None]:
    """Share the lock of a directory that is worked in, or hold it `alone` so that nobody begins to.

    A file system without locks keeps no process out.

    Raises:
        RunError: another process is at work there, in the way that does not go with this one.
        OSError: the directory does not exist.
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # no locks here
            if not _flock_soon(handle, shared=not alone):
                got, remedy = "one that another process is at work in", "wait for it, or stop it"
                raise RunError(got, place=str(folder), expected="an idle directory", remedy=remedy)
        yield
    finally:
        os.close(handle)


def is_in_use(path: Path, *, shared: bool = False) -> bool:
    """Return whether a process holds a file or directory at this moment; false where there are no locks.

    `shared` is whether others that share it, such as those that ask this, do not count.
    """
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError:
        return False
    try:
        return not flock(handle, shared=shared)
    except OSError:
        return False
    finally:
        os.close(handle)


def write_durably(path: Path, content: str | bytes, *, replace: bool = True, begun_in: Path | None = None) -> bool:
    """Write a whole file (text as UTF-8) in one step: a reader sees the old content or the new, even after a crash.

    Args:
        path: its directories are made.
        content: of the file.
        replace: whether it takes the place of a file that stands there, which stays otherwise.
        begun_in: the directory above it in which it is written before it has its name; its own where that is None.

    Returns:
        Whether it was written.

    Raises:
        StoreError: the disk is full or the directory cannot be written; the old content stays.
    """
    try:
        made = list(itertools.takewhile(lambda folder: not folder.exists(), path.parents))
        if made:
            path.parent.mkdir(parents=True, exist_ok=True)
        with _part_of(path, begun_in or path.parent) as file:
            file.write(content if isinstance(content, bytes) else content.encode())
            file.flush()
            os.fsync(file.fileno())
            if not HAS_LOCKS:  # Windows renames no open file
                file.close()
            is_written = True
            if replace:
                os.replace(file.name, path)  # atomic: a reader never sees half an entry
            else:
                is_written = _named(file.name, path)
        for folder in (path.parent, *(folder.parent for folder in made)):
            sync(folder)  # the names, too, must survive a crash; also that of a file which another has just written
    except OSError as error:
        raise StoreError(
            f"cannot be written: {error.strerror}; what stood there is unchanged",
            place=str(path),
            remedy="make room, or choose a directory that can be written to, and repeat the command",
        ) from error
    return is_written


def _named(part: str, path: Path) -> bool:
    """Give a finished file its name, unless another has it.

    Where a file system has no links, the later one of two writers at the same moment replaces the other's file.
    """
    try:
        os.link(part, path)
    except FileExistsError:
        return False
    except OSError as error:
        if error.errno not in _NO_LINKS:
            raise
        if path.exists():
            return False
        os.replace(part, path)
    return True


def remove_leftovers(folder: Path, *, is_deep: bool = True) -> None:
    """Remove the unfinished files of dead writers in a directory, and below it; those of living ones stay.

    What cannot be removed stays, too: it is another user's, the disk is read-only, or the file system has no `flock`.
    """
    for part in (folder.rglob if is_deep else folder.glob)(".*.part"):
        if _PART.fullmatch(part.name):
            with contextlib.suppress(OSError), part.open("rb+") as file:
                if flock(file.fileno()):
                    part.unlink()


@contextlib.contextmanager
def _part_of(path: Path, folder: Path) -> Iterator[BinaryIO]:
    """Open a new file for `path` in a directory, locked while it is open where that can be; removed if not renamed."""
    while True:
        part = folder / f".{path.name}.{secrets.token_hex(8)}.part"  # no other process's, on any machine
        with part.open("xb") as file:
            try:
                _lock(file)
                if os.fstat(file.fileno()).st_nlink:  # else it was removed as a leftover before it was locked
                    yield file
                    return
            finally:
                with contextlib.suppress(OSError):
                    part.unlink(missing_ok=True)


def _lock(file: BinaryIO) -> None:
    """Lock a new file; where the file system cannot, it needs no lock, since `remove_leftovers` fails there too."""
    try:
        flock(file.fileno(), wait=True)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise


def sync(path: Path) -> None:
    """Wait until a file or directory is on the disk; Windows opens no directory, and says nothing of it."""
    if not HAS_LOCKS:
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
