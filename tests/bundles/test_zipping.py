"""Promise: a zip file of ours tells nothing of its machine, and one of anybody's writes nothing where it should not."""

import contextlib
import io
import re
import struct
import zipfile
import zlib
from pathlib import Path

import pytest
from bundles import zipped

from tacevo.bundles.zipfiles import (
    FREE_BYTES,
    LONGEST_NAME,
    MOST_MEMBERS,
    MOST_OF_A_MEMBER,
    MOST_RATIO,
    Budget,
    packed,
    unpack,
)
from tacevo.errors import BundleError

ANY = re.compile(".*", re.DOTALL)

MEMBERS = {"a.txt": b"a" * 100, "folder/b.txt": b"b" * 100}


def unpacked(source: Path, folder: Path, *, budget: Budget | None = None) -> dict[str, str]:
    """Unpack with the budget of the file's size."""
    return unpack(source, folder, ANY, budget or Budget(source, source.stat().st_size))


def refused(source: Path, words: str) -> None:
    """See that a file is refused, and that nothing is written outside the folder it was given."""
    before = sorted(source.parent.rglob("*"))
    folder = source.parent / "inside"
    with pytest.raises(BundleError, match=words):
        unpacked(source, folder)
    assert sorted(path for path in source.parent.rglob("*") if folder not in (path, *path.parents)) == before


def test_members_come_back(tmp_path: Path) -> None:
    """Contents, names and digests."""
    (tmp_path / "x.zip").write_bytes(packed(MEMBERS))
    digests = unpacked(tmp_path / "x.zip", tmp_path / "inside")
    assert {name: (tmp_path / "inside" / name).read_bytes() for name in digests} == MEMBERS


def test_order_of_members_enters_nothing() -> None:
    """Equal members give equal bytes."""
    assert packed(MEMBERS) == packed(dict(reversed(MEMBERS.items())))


@pytest.mark.parametrize(
    "name",
    [
        "../evil",
        "a/../../evil",
        "/tmp/evil",
        "C:/evil",
        "C:\\evil",
        "a\\..\\..\\evil",
        "a//b",
        "./a",
        "",
        "a/",
        ".hidden",
        "a\nb",
        "ü.txt",
        "a b",
        "x" * (LONGEST_NAME + 1),
    ],
)
def test_name_that_leads_elsewhere_is_refused(name: str, tmp_path: Path) -> None:
    """Parents, roots, drives, backslashes, empty parts, hidden files and letters that vary between systems."""
    refused(zipped({"a.txt": b"", name: b"evil"}, tmp_path / "x.zip"), "is none of a file inside")


def test_name_behind_a_nul_is_refused(tmp_path: Path) -> None:
    """A library may end a name there."""
    source = zipped({"a.txt": b"", "b.txtXevil": b""}, tmp_path / "x.zip")
    source.write_bytes(source.read_bytes().replace(b"b.txtXevil", b"b.txt\0evil"))
    refused(source, "is none of a file inside")


def test_member_of_no_known_place_is_refused(tmp_path: Path) -> None:
    """Only the places that the caller names are written."""
    source = zipped(MEMBERS, tmp_path / "x.zip")
    with pytest.raises(BundleError, match=r"'folder/b.txt' is no file of a published run"):
        unpack(source, tmp_path / "inside", re.compile("a.txt"), Budget(source, 1000))


@pytest.mark.parametrize("mode", [0o120777, 0o040755, 0o010644, 0o020644, 0o060644, 0o140644, 0o104755, 0])
def test_special_member_is_refused(mode: int, tmp_path: Path) -> None:
    """Links, folders, pipes, devices, sockets, set-user-id."""

    def change(info: zipfile.ZipInfo) -> None:
        info.external_attr = mode << 16

    refused(zipped(MEMBERS, tmp_path / "x.zip", change), "'folder/b.txt' is a link, a folder or another special file")


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_second_member_of_a_name_is_refused(tmp_path: Path) -> None:
    """What is verified is what is read."""
    buffer = io.BytesIO(packed(MEMBERS))
    with zipfile.ZipFile(buffer, "a") as archive:
        info = zipfile.ZipInfo("a.txt")
        info.create_system, info.external_attr = 3, 0o100644 << 16
        archive.writestr(info, b"other")
    (tmp_path / "x.zip").write_bytes(buffer.getvalue())
    refused(tmp_path / "x.zip", "'a.txt' is there twice")


def test_names_that_differ_in_case_are_refused(tmp_path: Path) -> None:
    """On some systems one would be written over the other."""
    refused(zipped({"a.txt": b"1", "A.txt": b"2"}, tmp_path / "x.zip"), "'A.txt' is there twice, or is one file with")


def test_encrypted_member_is_refused(tmp_path: Path) -> None:
    """The flag alone is enough; nobody is asked for a password."""
    data = packed({"a.txt": b"1"})
    at, entry = data.index(b"PK\x03\x04"), data.index(b"PK\x01\x02")
    flagged = bytearray(data)
    flagged[at + 6] |= 1
    flagged[entry + 8] |= 1
    (tmp_path / "x.zip").write_bytes(flagged)
    refused(tmp_path / "x.zip", "'a.txt' is encrypted")


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_compression_is_refused(method: int, tmp_path: Path) -> None:
    """Only what we write is read."""

    def change(info: zipfile.ZipInfo) -> None:
        info.compress_type = method

    refused(zipped(MEMBERS, tmp_path / "x.zip", change), "is packed in a way in which no published run is")


def test_extra_field_is_refused(tmp_path: Path) -> None:
    """It could name another file, owner or size."""

    def change(info: zipfile.ZipInfo) -> None:
        info.extra = struct.pack("<HH4s", 0x7075, 4, b"evil")

    refused(zipped(MEMBERS, tmp_path / "x.zip", change), "is packed in a way in which no published run is")


@pytest.mark.parametrize("content", [b"", b"PK", b"no zip file at all, but some text that is long enough to be one"])
def test_foreign_file_is_refused(content: bytes, tmp_path: Path) -> None:
    """The message says what was expected."""
    (tmp_path / "x.zip").write_bytes(content)
    refused(tmp_path / "x.zip", "is no published run, or was damaged")


def test_file_is_refused_wherever_it_ends(tmp_path: Path) -> None:
    """A download that broke off, at every place."""
    data = packed(MEMBERS)
    for length in range(len(data)):
        (tmp_path / "x.zip").write_bytes(data[:length])
        refused(tmp_path / "x.zip", "is no published run, or was damaged")


def test_every_flipped_byte_is_noticed(tmp_path: Path) -> None:
    """Refused, or nothing changed but what has no meaning (times and versions in a header)."""
    data = packed(MEMBERS)
    (tmp_path / "x.zip").write_bytes(data)
    whole = unpacked(tmp_path / "x.zip", tmp_path / "whole")
    for place in range(len(data)):
        (tmp_path / "x.zip").write_bytes(data[:place] + bytes([data[place] ^ 0x55]) + data[place + 1 :])
        with contextlib.suppress(BundleError):
            assert unpacked(tmp_path / "x.zip", tmp_path / f"{place}") == whole


@pytest.mark.parametrize("around", [(b"#!/bin/sh\n", b""), (b"", b"more"), (b"", b"PK\x05\x06" + bytes(18))])
def test_bytes_around_a_file_are_refused(around: tuple[bytes, bytes], tmp_path: Path) -> None:
    """A script before it, or another directory behind it."""
    (tmp_path / "x.zip").write_bytes(around[0] + packed(MEMBERS) + around[1])
    refused(tmp_path / "x.zip", "x.zip is no published run|x.zip: ")


def test_bytes_between_members_are_refused(tmp_path: Path) -> None:
    """Nothing hides where no directory lists it."""
    data = bytearray(packed({"a.txt": b"1"}))
    at = data.index(b"PK\x01\x02")
    end = len(data) - 22
    (place,) = struct.unpack_from("<L", data, end + 16)
    struct.pack_into("<L", data, end + 16, place + 6)
    (tmp_path / "x.zip").write_bytes(bytes(data[:at]) + b"hidden" + bytes(data[at:]))
    refused(tmp_path / "x.zip", "something stands between its last member and its directory")


def test_bomb_is_stopped_while_it_unpacks(tmp_path: Path) -> None:
    """A thousand bytes of each byte: refused long before they are all there."""
    bomb = zipped({"a.txt": bytes(10 * FREE_BYTES)}, tmp_path / "x.zip")
    assert bomb.stat().st_size < FREE_BYTES // 50
    refused(bomb, "'a.txt' unpacks to more than a published run may")
    limit = max(FREE_BYTES, MOST_RATIO * bomb.stat().st_size)
    assert (tmp_path / "inside" / "a.txt").stat().st_size <= limit < 10 * FREE_BYTES


def test_size_that_a_header_claims_is_not_believed(tmp_path: Path) -> None:
    """A bomb that says it is small is cut at what it says, and is then damaged."""
    bomb = zipped({"a.txt": bytes(10 * FREE_BYTES)}, tmp_path / "x.zip")
    claimed = bomb.read_bytes().replace(struct.pack("<L", 10 * FREE_BYTES), struct.pack("<L", 5))
    bomb.write_bytes(claimed)
    refused(bomb, "was damaged: Bad CRC-32")
    assert (tmp_path / "inside" / "a.txt").stat().st_size <= 5


def test_many_members_share_one_budget(tmp_path: Path) -> None:
    """Members that are small one by one are counted together."""
    source = zipped({f"{number}": bytes(FREE_BYTES // 4) for number in range(6)}, tmp_path / "x.zip")
    refused(source, "'4' unpacks to more than a published run may")


def test_overlapping_members_are_refused(tmp_path: Path) -> None:
    """One body under many names makes a bomb of any size."""
    data = packed({"a": b"x"})
    start = data.index(b"PK\x01\x02")
    entry, end = data[start:-22], data[-22:]
    twice = entry + entry[:-1] + b"b"
    counts = struct.pack("<2HL", 2, 2, len(twice))
    (tmp_path / "x.zip").write_bytes(data[:start] + twice + end[:8] + counts + end[16:])
    refused(tmp_path / "x.zip", "'b' does not begin where the member before it ends")


def test_too_many_members_are_refused(tmp_path: Path) -> None:
    """Counted before any is written."""
    (tmp_path / "x.zip").write_bytes(packed({f"{number}": b"" for number in range(MOST_MEMBERS + 1)}))
    refused(tmp_path / "x.zip", f"{MOST_MEMBERS} is the most that one may have")
    assert not (tmp_path / "inside").exists()


def test_huge_directory_is_refused_unread(tmp_path: Path) -> None:
    """No memory is asked for by what the end of a file claims."""
    length = 400 * MOST_MEMBERS
    end = struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, 1, 1, length, 0, 0)
    with (tmp_path / "x.zip").open("wb") as file:
        file.truncate(length)
        file.seek(length)
        file.write(end)
    refused(tmp_path / "x.zip", "its directory lists more than")


@pytest.mark.parametrize(
    "change",
    [
        pytest.param((6, b"\x08\0"), id="flags"),
        pytest.param((8, b"\0\0"), id="method"),
        pytest.param((14, b"\0\0\0\0"), id="checksum"),
        pytest.param((18, b"\xff\xff\xff\xff"), id="packed size"),
        pytest.param((22, b"\xff\xff\xff\xff"), id="size"),
    ],
)
def test_two_descriptions_of_a_member_must_agree(change: tuple[int, bytes], tmp_path: Path) -> None:
    """Some programs believe the header before a member, some the directory; both must show the same file."""
    place, value = change
    content = bytearray(packed(MEMBERS))
    content[place : place + len(value)] = value
    (tmp_path / "x.zip").write_bytes(content)
    refused(tmp_path / "x.zip", "described in two ways")


def test_second_directory_is_refused(tmp_path: Path) -> None:
    """A zip64 record makes some programs read another directory than the one that ends the file."""
    (tmp_path / "x.zip").write_bytes(two_faced(b"good", b"evil"))
    refused(tmp_path / "x.zip", "second directory")


def test_member_has_a_limit_of_its_own(tmp_path: Path) -> None:
    """However much the whole may take, nobody parses more than this at once."""
    source = zipped({"a.txt": b"0" * (MOST_OF_A_MEMBER + 1)}, tmp_path / "x.zip")
    with pytest.raises(BundleError, match=r"'a\.txt' unpacks to more than"):
        unpacked(source, tmp_path / "inside", budget=Budget(source, MOST_OF_A_MEMBER))


def two_faced(good: bytes, evil: bytes) -> bytes:
    """Write a file that Python's library reads as `good`, and one without zip64 as `evil`."""
    first = _local(b"a.txt", good)
    hidden = _local(b"a.txt", evil)
    place = len(first) + 30 + len(b"b.txt")
    entry = struct.pack("<4s4B4H", b"PK\1\2", 20, 3, 20, 0, 0, 0, 0, 33)

    def listed(name: bytes, data: bytes, offset: int, behind: int = 0) -> bytes:
        sizes = (zlib.crc32(data), len(data), len(data))
        fields = struct.pack("<3L5H2L", *sizes, len(name), 0, behind, 0, 0, 0o100644 << 16, offset)
        return entry + fields + name

    def written(behind: int) -> tuple[bytes, int]:
        inside = hidden + listed(b"a.txt", evil, place, behind)
        second = _local(b"b.txt", inside)
        directory = listed(b"a.txt", good, 0) + listed(b"b.txt", inside, len(first))
        start = len(first) + len(second)
        record = struct.pack("<4sQ2H2L4Q", b"PK\6\6", 44, 45, 45, 0, 0, 2, 2, len(directory), start)
        tail = directory + record + struct.pack("<4sLQL", b"PK\6\7", 0, start + len(directory), 1)
        length = len(inside) - len(hidden) + len(tail)
        end = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 1, 1, length, place + len(hidden), 0)
        return first + second + tail + end, len(tail)

    _, behind = written(0)
    return written(behind)[0]


def _local(name: bytes, data: bytes) -> bytes:
    """Write a stored member with the header before it."""
    sizes = (zlib.crc32(data), len(data), len(data))
    return struct.pack("<4s5H3L2H", b"PK\3\4", 20, 0, 0, 0, 33, *sizes, len(name), 0) + name + data
