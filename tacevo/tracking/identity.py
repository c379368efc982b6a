"""The id of a folder: what its run or its sweep is found by in MLflow, also after the folder has a new name.

What it promises: a folder's id never changes, whoever asks for it first, and however many machines at once; it is
there whole or not at all. What it does not: a copy of the folder has the same id.
"""

import contextlib
import errno
import os
import re
import secrets
from pathlib import Path

from tacevo.errors import RunError

#: The file that holds the id.
FILE = ".tracking"

_ID = re.compile(rb"[0-9a-f]{32}\n")

#: What a disk says that is read-only, belongs to others, or knows no second name of a file.
_UNWRITABLE = frozenset({errno.EROFS, errno.EACCES, errno.EPERM, errno.EOPNOTSUPP})


def folder_id(folder: Path) -> str | None:
    """Give the id of a folder, 32 hex digits, made where it has none.

    Returns:
        None where there is none, and none can be written.

    Raises:
        RunError: the file that holds it is damaged.
        OSError: the folder is missing, or the disk is full or fails.
    """
    path = folder / FILE
    if not path.exists():
        try:
            _make(path)
        except OSError as error:
            if error.errno in _UNWRITABLE:
                return None
            raise
    text = path.read_bytes()
    if not _ID.fullmatch(text):
        raise RunError(
            f"{path} is damaged: expected 32 hex digits, got {text[:40]!r}; restore it, or delete it: MLflow then gets "
            f"what is in {folder} once more"
        )
    return text.decode().strip()


def _make(path: Path) -> None:
    part = path.with_name(f".{path.name}.{secrets.token_hex(8)}.part")  # if this is killed, `store.sweep` removes it
    try:
        with part.open("xb") as file:
            file.write(f"{secrets.token_hex(16)}\n".encode())
            file.flush()
            os.fsync(file.fileno())
        with contextlib.suppress(FileExistsError):  # another machine was quicker; unlike a rename, a link leaves its id
            os.link(part, path)
    finally:
        part.unlink(missing_ok=True)
    handle = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
