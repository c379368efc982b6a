"""Zip files whose bytes do not depend on the machine that wrote them. A reader checks every field.

What reading promises: nothing is written, and no more is held than the limits below. Every byte that is not a member's
data must be the one that `packed` writes there, so no link, directory, encryption, extra field, comment, zip64 record,
overlap or hidden byte is possible. The data themselves may differ: libraries deflate in different ways.
"""

import io
import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

from tacevo.errors import BundleError
from tacevo.storage.entries import Budget

#: A run of 10,000 candidates has some 10,100 members; without zip64, no zip file has more than 65,535.
MOST_MEMBERS = 50_000

#: The longest name; what `packed` writes is far shorter, and no file system takes much more.
LONGEST_NAME = 200

#: What one member may unpack to: a ledger of 10,000 candidates takes 13 MB. JSON may take 24 times that in memory.
MOST_OF_A_MEMBER = 32 * 1024**2

#: Letters that mean the same in every file system, each part of a name beginning with one that hides nothing.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*(/[A-Za-z0-9][A-Za-z0-9._-]*)*")

_MODE = stat.S_IFREG | 0o644

_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)

#: The earliest that a zip file knows.
_TIME = (1980, 1, 1, 0, 0, 0)

#: What to do about a file that somebody unpacked and packed again: its members may be the same, and its bytes are not.
_SEND = "send the file that `tacevo publish` wrote"

_PACKED_AGAIN = f"fetch the file again; if another program packed it again, {_SEND}"

_PUBLISHED = "a published run, as `tacevo publish` writes it"


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


def read_members(source: Path, places: re.Pattern[str], budget: Budget) -> dict[str, bytes]:
    """Read every member of a zip file, by name.

    Raises:
        BundleError: it is damaged, or holds what `packed` never writes, or a member whose name is not one of `places`.
        StoreError: it unpacks to more than the budget.
    """
    with source.open("rb") as file:
        infos = _listed(source, file)
        members: dict[str, bytes] = {}
        seen: set[str] = set()
        directory, end = bytearray(), 0
        for info in infos:
            name = _checked_name(source, info)
            if places.fullmatch(name) is None or name.casefold() in seen:
                raise _refusal(source, "only files of a published run, each once", repr(name), _PACKED_AGAIN)
            seen.add(name.casefold())
            header, entry = _written(info, end)
            file.seek(end)
            if info.header_offset != end or file.read(len(header)) != header:
                raise _refusal(source, _PUBLISHED, "another or a damaged file", _PACKED_AGAIN)
            members[name] = _content(source, info, file.read(info.compress_size))
            budget.spend(info.file_size, repr(name))
            directory += entry
            end = file.tell()
        count = len(infos)
        directory += struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, count, count, len(directory), end, 0)
        if file.read(len(directory) + 1) != directory:
            raise _refusal(source, _PUBLISHED, "another or a damaged file", _PACKED_AGAIN)
    return members


def _listed(source: Path, file: BinaryIO) -> list[zipfile.ZipInfo]:
    """List the members that the directory at the end of a zip file names."""
    try:
        infos = zipfile.ZipFile(file).infolist()
    except (zipfile.BadZipFile, NotImplementedError, ValueError, struct.error) as error:
        if zipfile.is_zipfile(file):
            raise _refusal(source, _PUBLISHED, "another or a damaged file", _PACKED_AGAIN) from error
        file.seek(0)
        if file.read(4) == b"PK\x03\x04":
            raise _refusal(source, "a complete zip file", "one that ends early", _PACKED_AGAIN) from error
        infos = []
    if not infos:
        remedy = f"name one, or fetch it again; if another program packed it, {_SEND}"
        raise BundleError("a file that is not one", place=str(source), expected=_PUBLISHED, remedy=remedy)
    if len(infos) > MOST_MEMBERS:
        raise _refusal(source, f"at most {MOST_MEMBERS} members", "more")
    return infos


def _refusal(source: Path, expected: str, got: str, remedy: str = "fetch the file again") -> BundleError:
    return BundleError(got, place=str(source), expected=expected, remedy=remedy)


def _checked_name(source: Path, info: zipfile.ZipInfo) -> str:
    """Return the name of a plain member."""
    name = info.orig_filename
    if info.flag_bits or info.extra or info.date_time != _TIME:
        expected = "plain members, stored or deflated, without times, flags and extra fields"
        raise _refusal(source, expected, "a file that another program packed again, or a damaged one", _SEND)
    if len(name) > LONGEST_NAME or _NAME.fullmatch(name) is None:
        raise _refusal(source, "names of files inside a published run", repr(name), _PACKED_AGAIN)
    is_large = info.file_size > MOST_OF_A_MEMBER or info.compress_size > 2 * MOST_OF_A_MEMBER
    if info.compress_type not in _METHODS or is_large:
        expected = f"plain members of at most {MOST_OF_A_MEMBER} bytes, stored or deflated"
        raise _refusal(source, expected, "another or a damaged one")
    return name


def _written(info: zipfile.ZipInfo, start: int) -> tuple[bytes, bytes]:
    """Return the header before a member's data, and its entry in the directory, as `packed` writes them."""
    plain = zipfile.ZipInfo(info.orig_filename, _TIME)
    plain.compress_type, plain.CRC = info.compress_type, info.CRC
    plain.compress_size, plain.file_size = info.compress_size, info.file_size
    header = plain.FileHeader(zip64=False)
    fixed, name = header[4:30], header[30:]
    made_on_unix = bytes([20, 3])
    return header, b"PK\x01\x02" + made_on_unix + fixed + struct.pack("<3H2L", 0, 0, 0, _MODE << 16, start) + name


def _content(source: Path, info: zipfile.ZipInfo, data: bytes) -> bytes:
    """Return what a member's data unpack to, and no more of it than its header says."""
    is_whole = len(data) == info.compress_size
    if info.compress_type == zipfile.ZIP_DEFLATED:
        unpacker = zlib.decompressobj(-zlib.MAX_WBITS)
        try:
            data = unpacker.decompress(data, info.file_size + 1)
        except zlib.error as error:
            raise _refusal(source, "members that can be unpacked", str(error)) from error
        is_whole = unpacker.eof and not unpacker.unused_data
    if not is_whole or len(data) != info.file_size or zlib.crc32(data) != info.CRC:
        expected = f"{info.filename!r} of the size and checksum in its header"
        raise _refusal(source, expected, "others: it is damaged")
    return data
