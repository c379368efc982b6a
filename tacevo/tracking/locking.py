"""One mirror at a time in a folder, on one machine."""

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from tacevo.errors import RunError


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
