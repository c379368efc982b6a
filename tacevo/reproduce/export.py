"""`tacevo cache export | import`: the entries that a run needs, as one file, and back into a store.

The file is a tar archive without compression, in which nothing depends on when, where or by whom it was made, so one
run gives one sequence of bytes. What an import promises: every entry is verified before the first one is written, and
none is written outside the stores or over a different answer.
"""

import io
import json
import re
import tarfile
from collections.abc import Mapping
from pathlib import Path
from typing import Self

from tacevo.errors import StoreError
from tacevo.records import Json
from tacevo.reproduce.replay import replay
from tacevo.runs.progress import Progress
from tacevo.storage.files import write_durably
from tacevo.storage.listing import take_in
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.store import KINDS
from tacevo.studies.study import replay_studies

#: Layout of the file.
SCHEMA = 1

#: The first member: what the others are, so that an archive that lost its end is noticed.
_MANIFEST = "manifest.json"

#: Where an entry lies: its kind, the first digits of its key, its key.
_PLACE = re.compile(rf"({'|'.join(KINDS)})/([0-9a-f]{{2}})/(\2[0-9a-f]{{62}})\.json")


class _PlainFile(tarfile.TarInfo):
    """A member of an import; headers of any other kind are refused before anything in them is followed.

    Extended headers and sparse files let a small archive claim any size, and no export has them.
    """

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> Self:
        """Read a header.

        Raises:
            ReadError: it is not that of a plain file.
        """
        info = super().frombuf(buf, encoding, errors)
        if info.type not in (tarfile.REGTYPE, tarfile.AREGTYPE):
            raise tarfile.ReadError(f"it holds {info.name!r}, which is no plain file")
        return info


def export(run: Path, target: Path, store: str | None, view: Progress) -> int:
    """Write the entries that a run and its finished studies need into one file: exactly those that a replay reads.

    Args:
        run: the run directory.
        target: the file to write; one that stands there is replaced.
        store: where the stores lie, if not where the run had them.
        view: who is told how far the replay is.

    Returns:
        The number of entries.

    Raises:
        DivergenceError: the run is not what its stores give.
        CacheMissError: a store lacks an answer.
        RunError: this is no finished run.
    """
    read: set[Path] = set()
    digest = replay(run, store, view, seen=read.add).digest
    replay_studies(run, store, view, seen=read.add)
    root = Path(store or RunDirectory(run).read_run()["config"]["store"]["root"])
    entries = {path.relative_to(root).as_posix(): path.read_bytes() for path in sorted(read)}
    manifest = {"schema": SCHEMA, "digest": digest, "entries": sorted(entries)}
    text = json.dumps(manifest, indent=1) + "\n"
    write_durably(target, _packed({_MANIFEST: text.encode(), **dict(sorted(entries.items()))}))
    return len(entries)


def import_file(source: Path, root: Path) -> tuple[int, int]:
    """Write the entries of an exported file into the stores.

    Args:
        source: what `export` wrote.
        root: the folder of the stores.

    Returns:
        The number of entries that were written, and of those that stood there already.

    Raises:
        StoreError: the file, a member of it or a place in the stores is not as it should be; nothing was written.
    """
    members = _unpacked(source)
    manifest = _manifest(source, members.pop(_MANIFEST, b""))
    if sorted(members) != manifest["entries"]:
        raise StoreError(f"{source} does not hold the entries that its manifest lists; export or copy it again")
    return take_in(source, members, root)


def _packed(members: Mapping[str, bytes]) -> bytes:
    """Write members as a tar archive without times, owners and modes of this machine."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for name, data in members.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            archive.addfile(info, io.BytesIO(data))
    return buffer.getvalue()


def _unpacked(source: Path) -> dict[str, bytes]:
    """Read every member into memory; only plain files, each of one entry's name and within the archive, pass."""
    members: dict[str, bytes] = {}
    try:
        most = source.stat().st_size
        with tarfile.open(source, mode="r:", tarinfo=_PlainFile) as archive:
            for info in archive:
                place = info.name == _MANIFEST or _PLACE.fullmatch(info.name) is not None
                if not place or info.name in members:
                    raise StoreError(f"{source} holds {info.name!r}, which is no entry of a store, or is there twice")
                if not 0 <= info.size <= most:
                    raise tarfile.ReadError(f"{info.name} claims {info.size} bytes, more than the whole file has")
                file = archive.extractfile(info)
                members[info.name] = b"" if file is None else file.read()
    except (OSError, tarfile.TarError, EOFError) as error:
        raise StoreError(f"{source} is no file that `tacevo cache export` wrote, or was damaged: {error}") from error
    return members


def _manifest(source: Path, data: bytes) -> dict[str, Json]:
    try:
        manifest: dict[str, Json] = json.loads(data)
        sound = manifest["schema"] == SCHEMA and isinstance(manifest["entries"], list)
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise StoreError(f"{source} has no manifest; it is no file that `tacevo cache export` wrote") from error
    if not sound:
        raise StoreError(f"{source} has a manifest of schema {manifest['schema']!r}; this version reads {SCHEMA}")
    return manifest
