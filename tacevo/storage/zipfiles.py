"""Zip files whose bytes do not depend on the machine that wrote them.

What reading promises: nothing is written, and no more is held than the limits below. Every member that the directory
lists is a plain file of a known place, once, of the size and checksum that stand there. What it does not: bytes that no
member has, before or between them, are not looked at, and nothing reads them.
"""

from __future__ import annotations

import contextlib
import io
import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from tacevo.errors import BundleError

if TYPE_CHECKING:
    from tacevo.storage.entries import ReadBudget

#: A run of 10,000 candidates has some 10,100 members; without zip64, no zip file has more than 65,535.
MOST_MEMBERS = 50_000

#: The longest name; what `packed` writes is far shorter, and no file system takes much more.
LONGEST_NAME = 200

#: The bytes to which one member may unpack: a ledger of 10,000 candidates takes 13 MB. JSON may take 24 times that in
#: memory.
MOST_OF_A_MEMBER = 32 * 1024**2

#: Letters that mean the same in every file system, each part of a name beginning with one that hides nothing.
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]*(/[A-Za-z0-9_][A-Za-z0-9._-]*)*")

_MODE = stat.S_IFREG | 0o644

#: The errors that reading a file may raise which is not a sound zip file.
_UNREADABLE = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, ValueError, struct.error)

_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)

#: The earliest that a zip file knows.
_TIME = (1980, 1, 1, 0, 0, 0)

#: The remedy for a file that somebody unpacked and packed again: its members may be the same, and its bytes are not.
_SEND = "send the file as tacevo wrote it"

_PACKED_AGAIN = f"fetch the file again; if another program packed it again, {_SEND}"

_WRITTEN = "a file that tacevo wrote, such as a published run"


def packed(members: Mapping[str, bytes]) -> bytes:
    """Write members as a zip file, sorted, without times, modes and owners of this machine."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in sorted(members.items()):
            info = zipfile.ZipInfo(name, _TIME)
            info.create_system = 3  # Unix, wherever this runs
            info.external_attr = _MODE << 16
            info.compress_type = zipfile.ZIP_STORED if name.endswith(".xz") else zipfile.ZIP_DEFLATED
            archive.writestr(info, data, compresslevel=9)
    return buffer.getvalue()


def names_in(source: Path) -> list[str] | None:
    """List the members that a zip file names, unverified; None where it cannot be read: `read_members` says why."""
    with contextlib.suppress(OSError, *_UNREADABLE), zipfile.ZipFile(source) as archive:
        return archive.namelist()
    return None


def read_members(source: Path, places: re.Pattern[str], budget: ReadBudget) -> dict[str, bytes]:
    """Read every member of a zip file, by name.

    Raises:
        BundleError: it cannot be read, is damaged, or holds what `packed` never writes, or a member whose name is not
            one of `places`.
        StoreError: it unpacks to more than the budget.
    """
    members: dict[str, bytes] = {}
    seen: set[str] = set()
    try:
        with zipfile.ZipFile(io.BytesIO(source.read_bytes())) as archive:
            for info in _listed(source, archive):
                name = _checked_name(source, info)
                if places.fullmatch(name) is None or name.casefold() in seen:
                    raise _refusal(source, "only files of its kind, each once", repr(name), _PACKED_AGAIN)
                seen.add(name.casefold())
                members[name] = _content(source, archive, info)
                budget.spend(info.file_size, repr(name))
    except OSError as error:
        raise _refusal(source, _WRITTEN, error.strerror or str(error)) from error
    except _UNREADABLE as error:
        raise _unreadable(source) from error
    return members


def _listed(source: Path, archive: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    """List the members that the directory at the end of a zip file names."""
    infos = archive.infolist()
    if not infos:
        raise _unreadable(source)
    if len(infos) > MOST_MEMBERS:
        raise _refusal(source, f"at most {MOST_MEMBERS} members", "more")
    if archive.comment:
        raise _refusal(source, _WRITTEN, "another or a damaged file", _PACKED_AGAIN)
    return infos


def _unreadable(source: Path) -> BundleError:
    remedy = f"name one, or fetch it again; if another program packed it, {_SEND}"
    return _refusal(source, _WRITTEN, "another file, or one that is damaged or ends early", remedy)


def _refusal(source: Path, expected: str, got: str, remedy: str = "fetch the file again") -> BundleError:
    return BundleError(got, place=str(source), expected=expected, remedy=remedy)


def _checked_name(source: Path, info: zipfile.ZipInfo) -> str:
    """Return the name of a plain member."""
    name = info.orig_filename
    if info.flag_bits or info.extra or info.date_time != _TIME or info.external_attr != _MODE << 16:
        expected = "plain members, stored or deflated, without times, modes, flags and extra fields"
        raise _refusal(source, expected, "a file that another program packed again, or a damaged one", _SEND)
    if len(name) > LONGEST_NAME or _NAME.fullmatch(name) is None:
        raise _refusal(source, "names of files inside such a file", repr(name), _PACKED_AGAIN)
    is_large = info.file_size > MOST_OF_A_MEMBER or info.compress_size > 2 * MOST_OF_A_MEMBER
    if info.compress_type not in _METHODS or is_large:
        expected = f"plain members of at most {MOST_OF_A_MEMBER} bytes, stored or deflated"
        raise _refusal(source, expected, "another or a damaged one")
    return name


def _content(source: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    """Return what a member's data unpack to, and no more of it than the directory says; its checksum is compared."""
    with archive.open(info) as file:
        data = file.read(info.file_size + 1)  # without a size, all of a bomb is unpacked
    if len(data) != info.file_size:
        raise _refusal(source, f"{info.filename!r} of the size in its header", "another: it is damaged")
    return data
