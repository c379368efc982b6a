"""Promise: an export holds exactly what a run needs, byte for byte the same; an import writes all of it or nothing."""

import io
import json
import shutil
import tarfile
from collections.abc import Callable
from pathlib import Path

import pytest
from smallest import Once

from tacevo.cli.app import main
from tacevo.errors import StoreError
from tacevo.records import Json
from tacevo.reproduce.export import import_file
from tacevo.storage.canonical import content_hash
from tacevo.storage.store import SEARCHED, Store

Members = dict[str, bytes]


@pytest.fixture(scope="session")
def exported(published: Path, once: Once) -> Path:
    """Return a directory with a run without a study, its stores (with a foreign entry), and its export."""

    def export(folder: Path) -> None:
        for name in ("run", "cache"):
            shutil.copytree(published / name, folder / name, ignore=shutil.ignore_patterns("studies"))
        Store(folder / "cache", "completions").write({"of": "another run"}, {"x": 1})
        command = ["cache", "export", str(folder / "run"), "--store", str(folder / "cache")]
        assert main([*command, "-o", str(folder / "run.tar")]) == 0

    return once("exported", export)


def members(archive: Path) -> Members:
    """Read an archive."""
    with tarfile.open(archive) as opened:
        return {info.name: opened.extractfile(info).read() for info in opened}  # type: ignore[union-attr]


def packed(contents: Members, target: Path, change: Callable[[tarfile.TarInfo], None] | None = None) -> Path:
    """Write an archive, with a change to the headers of all members but the manifest."""
    with tarfile.open(target, "w") as archive:
        for name, data in contents.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            if change is not None and name != "manifest.json":
                change(info)
            archive.addfile(info, io.BytesIO(data))
    return target


def listed(contents: Members) -> Members:
    """Let the manifest list what there is."""
    manifest = json.loads(contents["manifest.json"])
    manifest["entries"] = sorted(contents.keys() - {"manifest.json"})
    return {**contents, "manifest.json": json.dumps(manifest).encode()}


def files(root: Path) -> list[Path]:
    """List every file below a folder."""
    return sorted(path for path in root.rglob("*") if path.is_file())


def test_kinds_are_those_that_a_search_keeps(exported: Path) -> None:
    """A store that a search begins to use must be listed, or nobody verifies or exports it; images are made anew."""
    assert {path.name for path in (exported / "cache").iterdir()} == {*SEARCHED, "data"}


def test_export_holds_what_the_run_needs_and_nothing_else(exported: Path) -> None:
    """Every entry of this run's stores, and not the one of another run."""
    cache = exported / "cache"
    names = {path.relative_to(cache).as_posix() for kind in SEARCHED for path in (cache / kind).glob("*/*.json")}
    foreign = Store(cache, "completions").key({"of": "another run"})
    needed = names - {f"completions/{foreign[:2]}/{foreign}.json"}
    assert members(exported / "run.tar").keys() == needed | {"manifest.json"}


def test_import_into_nothing_is_enough_for_a_replay(exported: Path, tmp_path: Path) -> None:
    """What was exported is what a replay reads, elsewhere."""
    written, standing = import_file(exported / "run.tar", tmp_path / "cache")
    assert (written > 5, standing) == (True, 0)
    assert main(["replay", str(exported / "run"), "--store", str(tmp_path / "cache")]) == 0
    assert import_file(exported / "run.tar", tmp_path / "cache") == (0, written)


def test_export_has_the_same_bytes_from_anywhere(
    exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another day, folder and set of stores give the same file."""
    shutil.copytree(exported / "run", tmp_path / "elsewhere")
    import_file(exported / "run.tar", tmp_path / "stores")
    monkeypatch.chdir(tmp_path)
    assert main(["cache", "export", "elsewhere", "-o", "again.tar", "--store", "stores"]) == 0
    assert (tmp_path / "again.tar").read_bytes() == (exported / "run.tar").read_bytes()


def test_run_that_its_stores_do_not_give_is_not_exported(exported: Path, tmp_path: Path) -> None:
    """An export begins with a replay, and leaves no file where that fails."""
    shutil.copytree(exported / "run", tmp_path / "run")
    store = ["--store", str(tmp_path / "empty")]
    assert main(["cache", "export", str(tmp_path / "run"), "-o", str(tmp_path / "run.tar"), *store]) == 2
    assert not (tmp_path / "run.tar").exists()


def refused(archive: Path, root: Path, words: str) -> None:
    """Try an import, and see that it says so and writes nothing."""
    before = {path: path.read_bytes() for path in files(root)}
    with pytest.raises(StoreError, match=words):
        import_file(archive, root)
    assert {path: path.read_bytes() for path in files(root)} == before


@pytest.mark.parametrize(
    "name",
    [
        "../evil.json",
        "/tmp/evil.json",
        "completions/../../evil.json",
        "completions/ab/../../../evil.json",
        f"secrets/ab/{'ab' * 32}.json",
        f"completions/cd/{'ab' * 32}.json",
        f"completions/ab/{'ab' * 32}.json\n",
    ],
)
def test_strange_name_is_refused(name: str, exported: Path, tmp_path: Path) -> None:
    """No member is written anywhere but where an entry of its key belongs."""
    contents = members(exported / "run.tar")
    archive = packed(listed({**contents, name: b"{}"}), tmp_path / "evil.tar")
    refused(archive, tmp_path / "cache", "which is no entry of a store, or is there twice")
    assert files(tmp_path) == [archive]


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.DIRTYPE, tarfile.FIFOTYPE])
def test_link_folder_or_pipe_is_refused(kind: bytes, exported: Path, tmp_path: Path) -> None:
    """Only plain files are entries."""

    def change(info: tarfile.TarInfo) -> None:
        info.type, info.linkname, info.size = kind, "/etc/passwd", 0

    archive = packed(members(exported / "run.tar"), tmp_path / "evil.tar", change)
    refused(archive, tmp_path / "cache", "which is no plain file")


def headers(extended: dict[str, str]) -> bytes:
    """Write a member of 0 bytes with the name of an entry and with extended headers."""
    info = tarfile.TarInfo(f"completions/ab/{'ab' * 32}.json")
    info.pax_headers = extended
    return info.tobuf(tarfile.PAX_FORMAT)


@pytest.mark.parametrize(
    "extended",
    [
        {"GNU.sparse.map": "zero,none"},
        {"GNU.sparse.map": "0,0", "GNU.sparse.size": str(2**40)},
        {"GNU.sparse.major": "1", "GNU.sparse.minor": "0", "GNU.sparse.realsize": str(2**40)},
        {"size": "-512"},
        {"comment": "harmless"},
    ],
)
def test_extended_header_is_refused_unread(extended: dict[str, str], tmp_path: Path) -> None:
    """No export has one, and what it says of sizes and holes would be believed."""
    (tmp_path / "evil.tar").write_bytes(headers(extended) + bytes(1024))
    refused(tmp_path / "evil.tar", tmp_path / "cache", "is no file that .* which is no plain file")


def test_sparse_file_is_refused_unread(exported: Path, tmp_path: Path) -> None:
    """A member of GNU's own sparse type, which may claim any size with no byte of data."""

    def change(info: tarfile.TarInfo) -> None:
        info.type = tarfile.GNUTYPE_SPARSE

    archive = packed(members(exported / "run.tar"), tmp_path / "evil.tar", change)
    refused(archive, tmp_path / "cache", "which is no plain file")


@pytest.mark.parametrize("size", [10_000, 2**50, 2**80])
def test_member_larger_than_the_file_is_refused_unread(size: int, tmp_path: Path) -> None:
    """No memory is asked for by what a header claims."""
    info = tarfile.TarInfo("manifest.json")
    info.size = size
    (tmp_path / "evil.tar").write_bytes(info.tobuf(tarfile.GNU_FORMAT) + bytes(1024))
    refused(tmp_path / "evil.tar", tmp_path / "cache", f"claims {size} bytes, more than the whole file has")


@pytest.mark.parametrize("name", ["manifest.json", f"completions/ab/{'ab' * 32}.json"])
def test_endless_nesting_is_refused(name: str, exported: Path, tmp_path: Path) -> None:
    """JSON that is deeper than the parser goes is a bad file like any other."""
    contents = listed({**members(exported / "run.tar"), "completions/ab/" + "ab" * 32 + ".json": b"{}"})
    contents[name] = b"[" * 100_000
    refused(packed(contents, tmp_path / "deep.tar"), tmp_path / "cache", "has no manifest|is not a store entry")


@pytest.mark.parametrize(
    ("asked", "said"), [({"model": "m"}, {"text": "no completion"}), ({"model": 5}, None), (["m"], None)]
)
def test_completion_that_nobody_can_read_is_refused(asked: Json, said: Json, exported: Path, tmp_path: Path) -> None:
    """What `verify` would condemn afterwards does not come in, although its checksum is right."""
    contents = members(exported / "run.tar")
    sound = json.loads(next(contents[name] for name in sorted(contents) if name.startswith("completions/")))
    source = Store(tmp_path / "source", "completions")
    source.write(asked, sound["answer"] if said is None else said)
    (path,) = files(tmp_path / "source")
    contents[path.relative_to(tmp_path / "source").as_posix()] = path.read_bytes()
    refused(packed(listed(contents), tmp_path / "evil.tar"), tmp_path / "cache", "expected")


def test_second_member_of_a_name_is_refused(exported: Path, tmp_path: Path) -> None:
    """What is verified is what is written: no later member takes its place."""
    contents = members(exported / "run.tar")
    name = sorted(contents)[0]
    archive = packed(contents, tmp_path / "evil.tar")
    with tarfile.open(archive, "a") as opened:
        info = tarfile.TarInfo(name)
        opened.addfile(info, io.BytesIO(b""))
    refused(archive, tmp_path / "cache", "or is there twice")


def test_one_damaged_entry_stops_all(exported: Path, tmp_path: Path) -> None:
    """The last entry is verified before the first is written."""
    contents = members(exported / "run.tar")
    name = sorted(contents.keys() - {"manifest.json"})[-1]
    contents[name] = contents[name].replace(b'"answer"', b'"ansver"')
    refused(packed(contents, tmp_path / "evil.tar"), tmp_path / "cache", "is not a store entry|its checksum")


def test_entry_under_another_name_is_refused(exported: Path, tmp_path: Path) -> None:
    """A sound answer to another question does not pass for this one's."""
    contents = members(exported / "run.tar")
    first, second = sorted(name for name in contents if name.startswith("completions/"))[:2]
    contents[first] = contents[second]
    refused(packed(contents, tmp_path / "evil.tar"), tmp_path / "cache", "does not match its checksum")


def test_missing_entry_is_noticed(exported: Path, tmp_path: Path) -> None:
    """An archive that lost a member is not taken for a smaller one."""
    contents = members(exported / "run.tar")
    del contents[sorted(contents.keys() - {"manifest.json"})[-1]]
    refused(packed(contents, tmp_path / "less.tar"), tmp_path / "cache", "does not hold the entries that its manifest")


def test_other_answer_in_the_store_is_kept(exported: Path, tmp_path: Path) -> None:
    """A conflict is the user's to decide; nothing is written over, and nothing beside."""
    name = next(name for name in sorted(members(exported / "run.tar")) if name.startswith("completions/"))
    entry: dict[str, Json] = json.loads(members(exported / "run.tar")[name])
    entry.pop("checksum")
    entry["answer"]["text"] = "mine"
    target = tmp_path / "cache" / name
    target.parent.mkdir(parents=True)
    target.write_text(json.dumps({**entry, "checksum": content_hash(entry)}))
    refused(exported / "run.tar", tmp_path / "cache", "has another answer than .*; import into a store of its own")


def test_link_in_the_store_is_not_followed(exported: Path, tmp_path: Path) -> None:
    """A folder of the store that leads elsewhere is refused."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache" / "completions").symlink_to(tmp_path / "elsewhere")
    refused(exported / "run.tar", tmp_path / "cache", "leads out of .* by a link")


@pytest.mark.parametrize("content", [b"", b"not a tar", b"\x1f\x8b\x08" + b"0" * 2000])
def test_foreign_file_is_refused(content: bytes, tmp_path: Path) -> None:
    """The message says what was expected."""
    (tmp_path / "foreign").write_bytes(content)
    refused(tmp_path / "foreign", tmp_path / "cache", "is no file that `tacevo cache export` wrote")


@pytest.mark.parametrize("part", [0.3, 0.9])
def test_truncated_file_is_refused(part: float, exported: Path, tmp_path: Path) -> None:
    """A copy that broke off is noticed, wherever it did."""
    data = (exported / "run.tar").read_bytes().rstrip(b"\0")  # tar ends with zeros that mean nothing
    for length in (int(part * len(data)), int(part * len(data)) // 512 * 512):
        (tmp_path / "part.tar").write_bytes(data[:length])
        with pytest.raises(StoreError, match=r"was damaged|does not hold the entries|is not a store entry"):
            import_file(tmp_path / "part.tar", tmp_path / "cache")
        assert not (tmp_path / "cache").exists()


def test_manifest_of_another_version_is_refused(exported: Path, tmp_path: Path) -> None:
    """A later layout is not guessed at, and without a manifest it is no export."""
    contents = members(exported / "run.tar")
    later = {**contents, "manifest.json": b'{"schema": 2, "entries": []}'}
    refused(packed(later, tmp_path / "later.tar"), tmp_path / "cache", "schema 2; this version reads 1")
    del contents["manifest.json"]
    refused(packed(contents, tmp_path / "without.tar"), tmp_path / "cache", "has no manifest")


def test_commands_say_what_they_did(exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The numbers of entries that were written and that stood there."""
    for written in (True, False):
        assert main(["cache", "import", str(exported / "run.tar"), "--store", str(tmp_path / "cache")]) == 0
        out = capsys.readouterr().out
        assert out.startswith("0 entries written") != written
