"""Published runs taken apart, changed and put together again, as somebody would who means to deceive."""

import hashlib
import io
import json
import lzma
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tacevo.bundles.format import STORE, sealed
from tacevo.bundles.open import opened
from tacevo.cli.app import main
from tacevo.storage.canonical import canonical, readable
from tacevo.storage.entries import pack
from tacevo.storage.files import write_durably
from tacevo.storage.ledger import GENESIS, seal
from tacevo.storage.run_directory import MANIFEST
from tacevo.storage.store import Entry, read_entry

Members = dict[str, bytes]


@dataclass(frozen=True)
class Refused:
    """Replays members that must be refused, with checksums that fit unless `seal` is False."""

    folder: Path
    capsys: pytest.CaptureFixture[str]

    def __call__(self, members: Members, words: str, *, seal: bool = True) -> Path:
        """See exit status 1 and these words in one line; return the bundle."""
        bundle = (resealed if seal else zipped)(members, self.folder / "x.zip")
        assert main(["replay", str(bundle)]) == 1
        told = self.capsys.readouterr().err.splitlines()
        (said,) = [line for line in told if line.startswith(("refused: ", "different: "))]
        assert words in said
        assert "tacevo-" not in said
        return bundle


def members_of(bundle: Path) -> Members:
    """Read every member."""
    with zipfile.ZipFile(bundle) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def laid_out(bundle: Path, folder: Path) -> tuple[Path, Path]:
    """Write a sweep's bundle with the candidates' files of its store; return the directories of sweep and stores."""
    place = opened(bundle)
    for pattern in ("*", "*/*", "*/*/*", "*/*/*/*"):
        for path in place.folder.glob(pattern):
            if path.is_file():
                write_durably(folder / str(path).partition(", ")[2], path.read_bytes())
    for path in place.store.glob("*/*/*.json"):
        entry = read_entry(path)
        write_durably(folder / "store" / entry.place, readable(entry.sealed()))
    return folder / "sweep", folder / "store"


def resealed(members: Mapping[str, bytes], target: Path) -> Path:
    """Write a bundle with checksums that fit its members."""
    data, _ = sealed({name: content for name, content in members.items() if name != MANIFEST})
    target.write_bytes(data)
    return target


def zipped(members: Mapping[str, bytes], target: Path, change: Callable[[zipfile.ZipInfo], None] | None = None) -> Path:
    """Write members as they are, whatever their names and checksums, with a change to every header but the first."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for place, (name, data) in enumerate(members.items()):
            info = zipfile.ZipInfo(name)
            info.create_system, info.external_attr = 3, 0o100644 << 16
            info.compress_type = zipfile.ZIP_DEFLATED
            if change is not None and place:
                change(info)
            archive.writestr(info, data)
    target.write_bytes(buffer.getvalue())
    return target


def honest(members: Mapping[str, bytes]) -> Members:
    """Return members with a manifest that fits them."""
    others = {name: data for name, data in members.items() if name != MANIFEST}
    lines = [f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in sorted(others.items())]
    return {**others, MANIFEST: "".join(lines).encode()}


def entries_of(members: Mapping[str, bytes]) -> list[dict[str, Any]]:
    """Read the store entries."""
    return [json.loads(line) for line in lzma.decompress(members[STORE]).splitlines()[1:]]


def with_entries(members: Mapping[str, bytes], entries: list[dict[str, Any]]) -> Members:
    """Return members with other store entries, packed as they are packed by us."""
    return {**members, STORE: pack(Entry(**entry) for entry in entries)}


def with_line(members: Mapping[str, bytes], number: int, change: Callable[[dict[str, Any]], object]) -> Members:
    """Return members whose ledger has another line, every hash after it made anew, and the digest with them."""
    previous, lines = GENESIS, []
    for place, text in enumerate(members["run/ledger.jsonl"].splitlines()):
        entry = {key: value for key, value in json.loads(text).items() if key not in {"previous", "hash"}}
        if place == number:
            change(entry)
        line, previous = seal(entry, previous)
        lines.append(line)
    run = {**json.loads(members["run/run.json"]), "digest": previous}
    ledger = "".join(f"{canonical(line)}\n" for line in lines)
    return {**members, "run/ledger.jsonl": ledger.encode(), "run/run.json": json.dumps(run, indent=1).encode()}
