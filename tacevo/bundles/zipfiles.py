"""Zip files that tell nothing of where they were written, and that are read without believing anything in them.

What reading promises: nothing is written outside the folder it is given, and no more than the limits below; what a
header claims is never relied upon. Only the plain form that `packed` writes is read: no links, folders, encryption,
extra fields, comments, zip64, overlapping members, or bytes between them.
"""

import contextlib
import hashlib
import io
import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

from tacevo.errors import BundleError

#: A run of 10,000 candidates has some 10,100 members; without zip64, no zip file has more than 65,535.
MOST_MEMBERS = 50_000

#: What all members, and what is packed in them, may take on the disk: about four times a run of 10,000 candidates.
MOST_BYTES = 2 * 1024**3

#: What a file may unpack to, as a multiple of its own size. A run of 1,000 candidates comes to 12, one of 86 to 14;
#: deflate could make a thousand of it, LZMA many thousands.
MOST_RATIO = 200

#: A small file may unpack to this much whatever its ratio, which tells little of a few repeated lines.
FREE_BYTES = 16 * 1024**2

#: The longest name; what `packed` writes is far shorter, and no file system takes much more.
LONGEST_NAME = 200

#: Bytes that are unpacked at a time.
CHUNK = 1024**2

#: Letters that mean the same in every file system, each part of a name beginning with one that hides nothing.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*(/[A-Za-z0-9][A-Za-z0-9._-]*)*")

_MODE = stat.S_IFREG | 0o644

#: The record that ends a zip file: signature, two disks, two counts, size and place of the directory, comment.
_END = struct.Struct("<4s4H2LH")

#: The header before a member: signature, version, flags, method, time, day, CRC, two sizes, lengths of name and extra.
_HEADER = struct.Struct("<4s5H3L2H")

#: The earliest day that a zip file knows.
_DAY = 33

#: The fixed part of a member's entry in the directory, bytes.
_ENTRY = 46

#: What one member may unpack to: a ledger of 10,000 candidates takes 13 MB. JSON may take 24 times that in memory.
MOST_OF_A_MEMBER = 32 * 1024**2


class Budget:
    """Counts unpacked bytes, and stops at a limit.

    Args:
        source: the file that is unpacked, for the message.
        size: of that file, in bytes.
    """

    def __init__(self, source: Path, size: int) -> None:
        self._source = source
        self._left = min(MOST_BYTES, max(FREE_BYTES, MOST_RATIO * size))

    def spend(self, count: int, place: str) -> None:
        """Take note of bytes that were unpacked.

        Raises:
            BundleError: with these, the limit is passed.
        """
        self._left -= count
        if self._left < 0:
            raise BundleError(
                f"{self._source}: {place} unpacks to more than a published run may ({MOST_RATIO} times the file's size "
                f"and {MOST_BYTES} bytes); it is no honest bundle"
            )


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
    """Write every member of a zip file into an empty folder.

    Args:
        source: the file.
        folder: where to; it is the caller's to remove, also where this fails.
        places: the names that members may have.
        budget: what may be unpacked.

    Returns:
        The SHA-256 of each member, by name.

    Raises:
        BundleError: it is no zip file, was damaged, or holds what `packed` never writes; the message names the place.
    """
    with _read_as(source), source.open("rb") as file:
        place = _check_end(source, file)
        with zipfile.ZipFile(file) as archive:
            infos = archive.infolist()
            _check_names(source, infos, places)
            for info in infos:
                _check_header(source, info)
            _check_places(source, infos, archive.start_dir)
            if archive.start_dir != place:
                raise BundleError(f"{source}: it has a second directory (zip64), which no published run has")
            for info in infos:
                _check_second_header(source, file, info)
            return {info.filename: _extract(archive, info, folder / info.filename, budget) for info in infos}


@contextlib.contextmanager
def _read_as(source: Path) -> Iterator[None]:
    """Say of whatever the libraries cannot read that the file is damaged."""
    try:
        yield
    # NotImplementedError: a feature of zip files; RuntimeError: encryption; ValueError: bytes that are no name.
    except (zipfile.BadZipFile, zlib.error, EOFError, struct.error, ValueError, RuntimeError) as error:
        raise BundleError(
            f"{source} is no published run, or was damaged: {error or type(error).__name__}; fetch it again"
        ) from error


def _check_end(source: Path, file: BinaryIO) -> int:
    """Find the directory where it belongs, right before the end, before anybody reads it; give its place."""
    size = file.seek(0, io.SEEK_END)
    if size < _END.size:
        raise zipfile.BadZipFile("it is too short for a zip file")
    file.seek(-_END.size, io.SEEK_END)
    signature, *_, length, place, comment = _END.unpack(file.read(_END.size))
    if signature != b"PK\x05\x06" or comment != 0:
        raise zipfile.BadZipFile("it does not end as a zip file without a comment does")
    if place + length + _END.size != size:
        raise zipfile.BadZipFile("its directory is not where it belongs: something stands before or behind it")
    if length > MOST_MEMBERS * (_ENTRY + LONGEST_NAME):
        raise BundleError(f"{source}: its directory lists more than the {MOST_MEMBERS} members that one may have")
    return int(place)


def _check_names(source: Path, infos: Sequence[zipfile.ZipInfo], places: re.Pattern[str]) -> None:
    if len(infos) > MOST_MEMBERS:
        raise BundleError(f"{source}: it has {len(infos)} members; {MOST_MEMBERS} is the most that one may have")
    seen: dict[str, str] = {}
    for info in infos:
        name = info.orig_filename
        if name != info.filename or len(name) > LONGEST_NAME or _NAME.fullmatch(name) is None:
            raise BundleError(f"{source}: the name {name[:LONGEST_NAME]!r} is none of a file inside a published run")
        if places.fullmatch(name) is None:
            raise BundleError(f"{source}: {name!r} is no file of a published run")
        other = seen.get(name.casefold())
        if other is not None:
            raise BundleError(f"{source}: {name!r} is there twice, or is one file with {other!r} on some systems")
        seen[name.casefold()] = name


def _check_header(source: Path, info: zipfile.ZipInfo) -> None:
    """Refuse what is no plain file, compressed in one of two plain ways."""
    if info.flag_bits & 0x1:
        raise BundleError(f"{source}: {info.filename!r} is encrypted; a published run is open")
    if info.external_attr >> 16 != _MODE:
        raise BundleError(f"{source}: {info.filename!r} is a link, a folder or another special file")
    plain = info.compress_type in {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
    if not plain or info.flag_bits or info.extra or info.comment:
        raise BundleError(f"{source}: {info.filename!r} is packed in a way in which no published run is")


def _check_places(source: Path, infos: Sequence[zipfile.ZipInfo], directory: int) -> None:
    """See that members lie end to end, so that none is read twice under two names and nothing hides between them."""
    place = 0
    for info in infos:
        if info.header_offset != place:
            raise BundleError(f"{source}: {info.filename!r} does not begin where the member before it ends")
        place += _HEADER.size + len(info.filename) + info.compress_size
    if place != directory:
        raise BundleError(f"{source}: something stands between its last member and its directory")


def _check_second_header(source: Path, file: BinaryIO, info: zipfile.ZipInfo) -> None:
    """See that the header before a member says what the directory does: programs differ in which they believe."""
    name = info.filename.encode()
    sizes = (info.CRC, info.compress_size, info.file_size)
    expected = _HEADER.pack(b"PK\x03\x04", 20, 0, info.compress_type, 0, _DAY, *sizes, len(name), 0) + name
    file.seek(info.header_offset)
    whole = info.compress_type != zipfile.ZIP_STORED or info.compress_size == info.file_size
    if file.read(len(expected)) != expected or not whole:
        raise BundleError(f"{source}: {info.filename!r} is described in two ways that differ")


def _extract(archive: zipfile.ZipFile, info: zipfile.ZipInfo, target: Path, budget: Budget) -> str:
    """Write one member as it is unpacked, within the budget; return its SHA-256."""
    target.parent.mkdir(parents=True, exist_ok=True)
    digest = hashlib.sha256()
    taken = 0
    with archive.open(info) as member, target.open("xb") as file:
        while chunk := member.read(CHUNK):
            budget.spend(len(chunk), repr(info.filename))
            taken += len(chunk)
            if taken > MOST_OF_A_MEMBER:
                raise BundleError(f"{info.filename!r} unpacks to more than the {MOST_OF_A_MEMBER} bytes that one may")
            digest.update(chunk)
            file.write(chunk)
    return digest.hexdigest()
