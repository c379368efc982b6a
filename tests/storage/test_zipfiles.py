"""Promise: a zip file of ours tells nothing of its machine, and one of anybody's is read within limits or refused."""

import io
import re
import shutil
import struct
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import pytest
from bundles import zipped
from refusals import refused

from tacevo.errors import BundleError, StoreError, TacevoError
from tacevo.storage.entries import FREE_BYTES, MOST_RATIO, ReadBudget
from tacevo.storage.zipfiles import LONGEST_NAME, MOST_MEMBERS, MOST_OF_A_MEMBER, packed, read_members

ANY = re.compile(".*", re.DOTALL)

MEMBERS = {"a.txt": b"a" * 100, "folder/b.txt": b"b" * 100}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Return where a file is written; beside it nothing may be."""
    return tmp_path / "x.zip"


def unpacked(source: Path, *, budget: int = 0, places: re.Pattern[str] = ANY) -> dict[str, bytes]:
    """Read the members; nothing may be written."""
    try:
        return read_members(source, places, ReadBudget(source, budget or source.stat().st_size))
    finally:
        assert {path.name for path in source.parent.iterdir()} == {source.name}


def peak_of(source: Path) -> int:
    """Return the most memory that reading a file takes until it is refused, in bytes."""
    tracemalloc.start()
    with pytest.raises(TacevoError):
        unpacked(source)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak


def test_members_come_back_in_any_order(file: Path) -> None:
    """Stored or deflated, contents and names; equal members give equal bytes."""
    members = {**MEMBERS, "c.txt": bytes(5_000_000), "b.xz": bytes(range(256)) * 9_000}
    file.write_bytes(packed(members))
    assert unpacked(file) == members
    assert packed(dict(reversed(members.items()))) == file.read_bytes()


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
        "b.txt\0evil",
        "a b",
        "x" * (LONGEST_NAME + 1),
    ],
)
def test_name_that_leads_elsewhere_is_refused(name: str, file: Path) -> None:
    """Parents, roots, drives, backslashes, empty parts, hidden files, ends of names and blanks."""
    stand_in = "y" * len(name)
    file.write_bytes(packed({stand_in: b"evil"}).replace(stand_in.encode() or b"\n", name.encode() or b"\n"))
    with refused(BundleError, expected="names of files inside", got=repr(name)[1:-1][:50]):
        unpacked(file)


def test_member_of_no_known_place_is_refused(file: Path) -> None:
    """Only the places that the caller names are written."""
    file.write_bytes(packed(MEMBERS))
    with refused(BundleError, expected="only files of its kind", got="'folder/b.txt'"):
        unpacked(file, places=re.compile("a.txt"))


@pytest.mark.parametrize("names", [("a.txt", "a.txt"), ("a.txt", "A.txt")])
def test_second_member_of_a_name_is_refused(names: tuple[str, str], file: Path) -> None:
    """What is verified is what is read; on some systems names that differ in case are one file."""
    file.write_bytes(packed({names[0]: b"1", "Z.txt": b"2"}).replace(b"Z.txt", names[1].encode()))
    with refused(BundleError, expected="each once"):
        unpacked(file)


@pytest.mark.parametrize("content", [b"", b"PK", b"no zip file at all, but some text that is long enough to be one"])
def test_foreign_file_is_refused(content: bytes, file: Path) -> None:
    """The message says what was expected, and what to do."""
    file.write_bytes(content)
    with refused(BundleError, place="x.zip", expected="a published run", remedy="name one, or fetch it again"):
        unpacked(file)


def test_no_cut_and_no_flipped_byte_changes_what_is_read(file: Path) -> None:
    """A download that was cut or damaged, at every place, is refused, or its members are what they were.

    One may be gone; the manifest knows of all.
    """
    data = packed(MEMBERS)
    for length in range(len(data)):
        file.write_bytes(data[:length])
        with pytest.raises(BundleError):
            read_members(file, ANY, ReadBudget(file, len(data)))
    for place in range(len(data)):
        file.write_bytes(data[:place] + bytes([data[place] ^ 0x55]) + data[place + 1 :])
        try:
            members = read_members(file, ANY, ReadBudget(file, len(data)))
        except BundleError:
            continue
        assert set(members.values()) <= set(MEMBERS.values())


def test_bomb_is_stopped_while_it_unpacks(file: Path) -> None:
    """Members that are small one by one are counted together, and no more than the limit is held."""
    file.write_bytes(packed({f"{number:02}": bytes(FREE_BYTES // 4) for number in range(40)}))
    assert file.stat().st_size < FREE_BYTES // 50
    with refused(StoreError, expected="unpacks to at most", got="more"):
        unpacked(file)
    assert peak_of(file) <= max(FREE_BYTES, MOST_RATIO * file.stat().st_size) + FREE_BYTES // 2  # one member more


@pytest.mark.parametrize("claimed", [5, MOST_OF_A_MEMBER])
def test_size_that_a_header_claims_is_not_believed(claimed: int, file: Path) -> None:
    """A member that unpacks to more or less than it says is refused."""
    true, false = (struct.pack("<L", number) for number in (FREE_BYTES, claimed))
    file.write_bytes(packed({"a.txt": bytes(FREE_BYTES)}).replace(true, false))
    with refused(BundleError, place="x.zip"):
        unpacked(file)
    assert peak_of(file) <= 2 * claimed + FREE_BYTES // 4


def test_overlapping_members_are_refused(file: Path) -> None:
    """One body under many names makes a bomb of any size."""
    data = packed({"a": b"x"})
    start = data.index(b"PK\x01\x02")
    entry, end = data[start:-22], data[-22:]
    twice = entry + entry[:-1] + b"b"
    counts = struct.pack("<2HL", 2, 2, len(twice))
    file.write_bytes(data[:start] + twice + end[:8] + counts + end[16:])
    with refused(BundleError, expected="a file that tacevo wrote"):
        unpacked(file)


@pytest.mark.slow
def test_too_many_members_are_refused(file: Path) -> None:
    """A file has no more than one run of ten thousand candidates needs."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for number in range(MOST_MEMBERS + 1):
            archive.writestr(zipfile.ZipInfo(f"{number}"), b"")
    file.write_bytes(buffer.getvalue())
    with refused(BundleError, expected=f"at most {MOST_MEMBERS} members"):
        unpacked(file)


def test_member_has_a_limit_of_its_own(file: Path) -> None:
    """However much the whole may take, nobody parses more than this at once."""
    file.write_bytes(packed({"a.txt": b"0" * (MOST_OF_A_MEMBER + 1)}))
    with refused(BundleError, expected=f"at most {MOST_OF_A_MEMBER} bytes"):
        unpacked(file, budget=MOST_OF_A_MEMBER)


#: In every header but the first: links, directories, pipes, devices, sockets, set-user-id, no mode, or another umask's;
#: a time, as programs that pack files record; a field that could name another file, owner or size.
NOT_PLAIN: list[dict[str, Any]] = [
    *(
        {"external_attr": mode << 16}
        for mode in (0o120777, 0o040755, 0o010644, 0o020644, 0o060644, 0o140644, 0o104755, 0, 0o100600)
    ),
    {"date_time": (2026, 11, 24, 12, 0, 0)},
    {"extra": struct.pack("<HHBL4s", 0x7075, 9, 1, 0, b"evil")},
]

SENT = "send the file as tacevo wrote it"


def with_headers(file: Path, headers: dict[str, Any]) -> Path:
    """Write members whose headers, but for the first, have other values."""

    def change(info: zipfile.ZipInfo) -> None:
        for name, value in headers.items():
            setattr(info, name, value)

    return zipped(MEMBERS, file, change)


@pytest.mark.parametrize("headers", NOT_PLAIN)
def test_member_that_is_not_plain_is_refused(headers: dict[str, Any], file: Path) -> None:
    """Equal members in another program's zip file are another file, and no download mends that."""
    with refused(BundleError, place="x.zip", expected="plain members", remedy=SENT):
        unpacked(with_headers(file, headers))


def test_encrypted_member_is_refused(file: Path) -> None:
    """Nobody is asked for a password."""
    content = bytearray(packed(MEMBERS))
    content[content.index(b"PK\x01\x02") + 8] = 1
    file.write_bytes(content)
    with refused(BundleError, expected="plain members"):
        unpacked(file)


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_compression_is_refused(method: int, file: Path) -> None:
    """Only what we write is read."""
    with refused(BundleError, expected="stored or deflated"):
        unpacked(with_headers(file, {"compress_type": method}))


@pytest.mark.parametrize("kind", ["zip", "gztar", "tar"])
@pytest.mark.parametrize("inside", [".", "a folder"])
def test_folder_that_was_packed_is_told_so(kind: str, inside: str, tmp_path: Path) -> None:
    """With its directories, below one of another name, or by another kind of program."""
    whole = tmp_path / "whole"
    for name, data in MEMBERS.items():
        (whole / inside / name).parent.mkdir(parents=True, exist_ok=True)
        (whole / inside / name).write_bytes(data)
    made = Path(shutil.make_archive(str(tmp_path / "made"), kind, whole))
    (tmp_path / "alone").mkdir()
    with refused(BundleError, place=made.name, remedy=SENT):
        unpacked(made.rename(tmp_path / "alone" / made.name))
