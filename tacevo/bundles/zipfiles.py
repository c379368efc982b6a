"""Zip files whose bytes do not depend on the machine that wrote them. A reader checks every field.

What reading promises: nothing is written outside the directory it is given, and no more than the limits below. Every
byte that is not a member's data must be the one that `packed` writes there, so no link, directory, encryption, extra
field, comment, zip64 record, overlap or hidden byte is possible. The data themselves may differ: libraries deflate in
different ways.
"""

import hashlib
import io
import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import BinaryIO, NamedTuple

from tacevo.errors import BundleError
from tacevo.storage.entries import CHUNK, Budget

#: A run of 10,000 candidates has some 10,100 members; without zip64, no zip file has more than 65,535.
MOST_MEMBERS = 50_000

#: The longest name; what `packed` writes is far shorter, and no file system takes much more.
LONGEST_NAME = 200

#: What one member may unpack to: a ledger of 10,000 candidates takes 13 MB. JSON may take 24 times that in memory.
MOST_OF_A_MEMBER = 32 * 1024**2

#: Letters that mean the same in every file system, each part of a name beginning with one that hides nothing.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*(/[A-Za-z0-9][A-Za-z0-9._-]*)*")

_MODE = stat.S_IFREG | 0o644

#: What a member's header and its entry in the directory share: version, flags, method, time, day (the earliest that a
#: zip file knows), CRC, packed and unpacked size, lengths of name and extra field.
_MEMBER = struct.Struct("<5H3L2H")

_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


#: What to do about a file that somebody unpacked and packed again: its members may be the same, and its bytes are not.
_SEND = "send the file that `tacevo publish` wrote"

_PACKED_AGAIN = f"fetch the file again; if another program packed it again, {_SEND}"


class _Header(NamedTuple):
    """What the header of a member says of its data."""

    method: int
    crc: int
    packed_size: int
    size: int


def packed(members: Mapping[str, bytes]) -> bytes:
    """Write members as a zip file, sorted, without times, modes and owners of this machine."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in sorted(members.items()):
            info = zipfile.ZipInfo(name)  # its time is the earliest that a zip file knows
            info.create_system = 3  # Unix, wherever this runs
            info.external_attr = _MODE << 16
            info.compress_type = zipfile.ZIP_STORED if name.endswith(".xz") else zipfile.ZIP_DEFLATED
            archive.writestr(info, data, compresslevel=9)
    return buffer.getvalue()


def unpack(source: Path, folder: Path, places: re.Pattern[str], budget: Budget) -> dict[str, str]:
    """Write every member of a zip file into an empty directory; return the SHA-256 of each, by name.

    The caller removes the directory, also if this fails. Only members with a name of `places` are written.

    Raises:
        BundleError: it is damaged, or holds what `packed` never writes.
        StoreError: it unpacks to more than the budget.
    """
    digests: dict[str, str] = {}
    seen: set[str] = set()
    directory = bytearray()
    with source.open("rb") as file:
        while (signature := file.read(4)) == b"PK\x03\x04":
            start, fixed = file.tell() - 4, file.read(_MEMBER.size)
            if len(digests) == MOST_MEMBERS:
                raise _refusal(source, f"at most {MOST_MEMBERS} members", "more")
            name, header = _header(source, fixed, file)
            if places.fullmatch(name) is None or name.casefold() in seen:
                raise _refusal(source, "only files of a published run, each once", repr(name), _PACKED_AGAIN)
            seen.add(name.casefold())
            directory += b"PK\x01\x02" + bytes([20, 3]) + fixed  # by version 2.0 on Unix
            directory += struct.pack("<3H2L", 0, 0, 0, _MODE << 16, start) + name.encode()
            digests[name] = _write(source, folder / name, header, _data(source, file, header), budget)
        place, count = file.tell() - len(signature), len(digests)
        end = directory + struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, count, count, len(directory), place, 0)
        expected = "a published run, as `tacevo publish` writes it"
        if not digests:
            remedy = f"name one, or fetch it again; if another program packed it, {_SEND}"
            raise BundleError("a file that is not one", place=str(source), expected=expected, remedy=remedy)
        if signature + file.read(len(end)) != end:
            raise _refusal(source, expected, "another or a damaged file", _PACKED_AGAIN)
    return digests


def _refusal(source: Path, expected: str, got: str, remedy: str = "fetch the file again") -> BundleError:
    return BundleError(got, place=str(source), expected=expected, remedy=remedy)


def _header(source: Path, fixed: bytes, file: BinaryIO) -> tuple[str, _Header]:
    """Read the header of a member; return its name, and what it says of the data."""
    if len(fixed) == _MEMBER.size:
        version, flags, method, time, day, crc, packed_size, size, length, extra = _MEMBER.unpack(fixed)
        name = file.read(min(length, LONGEST_NAME + 1)).decode(errors="replace")
        if (version, flags, time, day, extra) != (20, 0, 0, 33, 0):
            expected = "plain members, stored or deflated, without times, flags and extra fields"
            raise _refusal(source, expected, "a file that another program packed again, or a damaged one", _SEND)
        if len(name) > LONGEST_NAME or _NAME.fullmatch(name) is None:
            raise _refusal(source, "names of files inside a published run", repr(name), _PACKED_AGAIN)
        if method in _METHODS and size <= MOST_OF_A_MEMBER:
            return name, _Header(method, crc, packed_size, size)
    expected = f"plain members of at most {MOST_OF_A_MEMBER} bytes, stored or deflated"
    raise _refusal(source, expected, "another or a damaged one")


def _data(source: Path, file: BinaryIO, header: _Header) -> Iterator[bytes]:
    """Unpack the data of a member a piece at a time."""
    unpacker, left = zlib.decompressobj(-zlib.MAX_WBITS), header.packed_size
    stored = header.method == zipfile.ZIP_STORED
    try:
        while left and (chunk := file.read(min(left, CHUNK))):
            left -= len(chunk)
            if stored:
                yield chunk
                continue
            while chunk:
                yield unpacker.decompress(chunk, CHUNK)
                chunk = unpacker.unconsumed_tail
        yield unpacker.flush()
    except zlib.error as error:
        raise _refusal(source, "members that can be unpacked", str(error)) from error
    if left:
        raise _refusal(source, "a complete zip file", "one that ends early")
    if unpacker.unused_data or not (stored or unpacker.eof):
        raise _refusal(source, "members that end where their headers say", "another end")


def _write(source: Path, target: Path, header: _Header, data: Iterator[bytes], budget: Budget) -> str:
    """Write a member as it is unpacked, within the budget; return its SHA-256."""
    target.parent.mkdir(parents=True, exist_ok=True)
    digest, crc, left = hashlib.sha256(), 0, header.size
    with target.open("xb") as file:
        for chunk in data:
            budget.spend(len(chunk), repr(target.name))
            left -= len(chunk)
            if left < 0:
                break
            crc = zlib.crc32(chunk, crc)
            digest.update(chunk)
            file.write(chunk)
    if left or crc != header.crc:
        raise _refusal(source, f"{target.name!r} of the size and checksum in its header", "others: it is damaged")
    return digest.hexdigest()
