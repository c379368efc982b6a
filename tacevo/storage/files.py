"""One mirror at a time in a folder, on one machine."""

import contextlib
import errno
import fcntl
import itertools
import os
import re
import secrets
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from tacevo.errors import RunError, StoreError

#: How often a lock that somebody holds is tried again, and after how many seconds each.
_PATIENCE, _PAUSE = 20, 0.05

#: A file in the making: hidden beside what it will be, and locked by its writer.
_PART = re.compile(r"\..+\.[0-9a-f]{16}\.part")

#: What `flock` answers where a file system has no locks.
_NO_LOCKS = {errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK}


@contextlib.contextmanager
def alone(folder: Path, *, wait: bool = True) -> Iterator[None]:
    """See that no other process is at work in a folder, and keep others away.

    Nothing is written: the folder itself is locked. A file system without locks, or one across a network that locks no
    folders, keeps nobody away.

    Args:
        folder: the folder.
        wait: for the other process, as long as it takes.

    Raises:
        RunError: another process is at work there, and is not to be waited for.
        OSError: there is no such folder.
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise RunError(
                f"{folder} is being mirrored by its search, or by another `tacevo track`; give the command again when "
                "that is done"
            ) from error
        except OSError:  # no locks here
            pass
        yield
    finally:
        os.close(handle)


@contextlib.contextmanager
def locked(folder: Path, setting: str) -> Iterator[None]:
    """Hold a folder for this process alone; a killed process lets go of it by itself.

    Args:
        folder: made where it is absent.
        setting: what names it, e.g. `run.dir`.

    Raises:
        RunError: another process is at work in it, or the folder cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder / ".lock", os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise RunError(f"{setting}={folder} cannot be used: {error}") from error
    try:
        _take(handle)
    except BlockingIOError as error:
        raise RunError(f"another process is running in {folder}; wait for it, or choose another {setting}") from error
    else:
        yield
    finally:
        os.close(handle)


def _take(handle: int) -> None:
    """Lock a file, waiting a little: who only looks whether it is locked (`RunDirectory.is_busy`) holds it so long.

    Raises:
        BlockingIOError: somebody holds it all the while.
    """
    for _ in range(_PATIENCE):
        with contextlib.suppress(BlockingIOError):
            return fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        time.sleep(_PAUSE)
    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def write_durably(path: Path, content: str | bytes) -> None:
    """Write a whole file (text as UTF-8) in one step: a reader sees the old content or the new, even after a crash.

    Raises:
        StoreError: the disk is full or the folder cannot be written; the old content stays.
    """
    try:
        made = list(itertools.takewhile(lambda folder: not folder.exists(), path.parents))
        if made:
            path.parent.mkdir(parents=True, exist_ok=True)
        with _part_of(path) as file:
            file.write(content if isinstance(content, bytes) else content.encode())
            file.flush()
            os.fsync(file.fileno())
            os.replace(file.name, path)  # atomic: a reader never sees half an entry
        for folder in (path.parent, *(folder.parent for folder in made)):
            _sync_folder(folder)  # the names, too, must survive a crash
    except OSError as error:
        raise StoreError(
            f"{path} cannot be written: {error.strerror}; what stood there is unchanged. Make room or choose a folder "
            "that can be written to, and run the same command again"
        ) from error


def sweep(folder: Path) -> None:
    """Remove the files in the making, anywhere in a folder, whose writers are dead; those of the living stay.

    What cannot be removed stays too: it is another user's, who will sweep it up, or the disk is read-only, or the file
    system has no `flock`.
    """
    for part in folder.rglob(".*.part"):
        if _PART.fullmatch(part.name):
            with contextlib.suppress(OSError), part.open("rb+") as file:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                part.unlink()


@contextlib.contextmanager
def _part_of(path: Path) -> Iterator[BinaryIO]:
    """Open a new file beside `path`, locked as long as it is open where that can be; removed unless it was renamed."""
    while True:
        part = path.with_name(f".{path.name}.{secrets.token_hex(8)}.part")  # nobody else's, on whatever machine
        with part.open("xb") as file:
            try:
                _lock(file)
                if os.fstat(file.fileno()).st_nlink:  # else it was swept up before it was locked
                    yield file
                    return
            finally:
                with contextlib.suppress(OSError):
                    part.unlink(missing_ok=True)


def _lock(file: BinaryIO) -> None:
    """Lock a new file; where the file system cannot, it needs no lock, since `sweep` fails there too."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
