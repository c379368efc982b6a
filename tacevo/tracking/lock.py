"""The lock of a directory that is mirrored: what two processes wrote into MLflow at once would be there twice."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from tacevo.errors import RunError
from tacevo.storage.files import flock


@contextlib.contextmanager
def alone(folder: Path, *, wait: bool = True) -> Iterator[None]:
    """Keep other processes out of a directory; by default, wait for the one at work there, as long as it takes.

    Nothing is written: the directory itself is locked. A file system without locks, or one across a network that cannot
    lock directories, keeps no process out.

    Raises:
        RunError: another process is at work there, and `wait` is False.
        OSError: the directory does not exist.
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # no locks here
            if not flock(handle, wait=wait):
                got = "one that its search or another `tacevo track` is mirroring"
                remedy = "repeat the command when that is done"
                raise RunError(got, place=str(folder), expected="an idle run", remedy=remedy)
        yield
    finally:
        os.close(handle)
