"""A published run: one zip file with a run's folder, the store entries it needs, its studies, tables and figures.

docs/publishing.md describes it member by member. What opening promises: every member is where it belongs and is what
the manifest says, and no other is there; all of it lies in a private folder, which is removed however the work ends,
but for a killed process. What it does not: a manifest can be written anew by whoever edits a member, so only a replay
(`tacevo.verifying`) tells whether the records follow from each other.
"""

import contextlib
import hashlib
import json
import re
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from tacevo import solid
from tacevo.errors import BundleError, RunError, TacevoError
from tacevo.rundir import RunDirectory
from tacevo.zipping import Budget, packed, unpack

#: The digests of all other members, in the form that `sha256sum --check` reads.
MANIFEST = "manifest-sha256.txt"

#: The store entries (`tacevo.solid`).
STORE = "store.jsonl.xz"

#: What describes the bundle to people and to archives.
PAPERS = ("CITATION.cff", "LICENSE.txt", "README.md", "ro-crate-metadata.json")

#: A run's own files.
RUN_FILES = ("archive.json", "ledger.jsonl", "prompts.json", "run.json", "summary.md", "timings.jsonl")

#: The environment, where it was known.
LOCK = "requirements.lock"

#: Members that a bundle may lack.
_OPTIONAL = {LOCK, "run/timings.jsonl"}

_REQUIRED = {MANIFEST, STORE, *PAPERS, *(f"run/{name}" for name in RUN_FILES)} - _OPTIONAL

_WORD = r"[A-Za-z0-9][A-Za-z0-9._-]*"

#: The name of every member.
_PLACES = re.compile(
    "|".join(map(re.escape, sorted(_REQUIRED | _OPTIONAL)))
    + r"|run/candidates/g[0-9]+s[0-9]+\.(py|rejected\.txt)"
    + rf"|run/studies/{_WORD}/(study\.json|scores\.jsonl)"
    + rf"|tables/{_WORD}\.(csv|md|tex)"
    + rf"|figures/{_WORD}\.pdf"
)

_MANIFEST_LINE = re.compile(r"([0-9a-f]{64})  (.+)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Opened:
    """A run, wherever it lies."""

    #: Its folder.
    run: Path
    #: The folder of its stores.
    store: Path
    #: The folder of all members of a bundle, where those of `run` lie a folder deeper; None for a run folder.
    root: Path | None = None
    #: Of a bundle: SHA-256 of its manifest, which stands for every byte of it.
    digest: str | None = None


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Opened]:
    """Open the folder of a run, or a bundle, verified against its manifest, in a private temporary folder.

    Args:
        path: the folder or the file.

    Raises:
        BundleError: the bundle is damaged, or holds what none should; the message names the place.
        RunError: it is neither a run's folder nor a file.
    """
    if not path.is_file():
        directory = RunDirectory(path)
        run = directory.read_run()
        with directory.believed():
            found = Opened(run=path, store=Path(run["config"]["store"]["root"]))
        yield found
        return
    with private_folder(path) as folder:
        yield _unpacked(path, folder)


def insist_on_walls(found: Opened) -> None:
    """Refuse to run the candidates of a bundle that would itself take the sandbox's walls down.

    Raises:
        BundleError: it asks for `sandbox.require=none`, or for a GPU, whose driver works behind no walls.
    """
    if found.root is None:
        return
    directory = RunDirectory(found.run)
    with directory.believed():
        config = directory.read_run()["config"]
        asked = {"sandbox.require": config["sandbox"]["require"], "training.device": config["training"]["device"]}
    for key, value in asked.items():
        if value in {"none", "cuda"}:
            raise BundleError(
                f"the published run has {key}={value}, with which its candidates would run here without walls; if you "
                "trust every source in it, unpack it and give its folder run/ instead"
            )


@contextlib.contextmanager
def private_folder(place: Path) -> Iterator[Path]:
    """Give a temporary folder that stands for a place; messages of errors name that place instead.

    It is this user's alone, and removed at the end, also where that is an error or Ctrl-C.
    """
    with tempfile.TemporaryDirectory(prefix="tacevo-") as folder:
        try:
            yield Path(folder)
        except TacevoError as error:
            raise type(error)(str(error).replace(folder, str(place))) from error


def sealed(members: Mapping[str, bytes]) -> tuple[bytes, str]:
    """Write a bundle from its members, without the manifest; equal members give equal bytes.

    Returns:
        The file, and the bundle's digest.

    Raises:
        RunError: a member's name is none that a bundle may have, e.g. since a task's name holds strange letters.
    """
    for name in members:
        if _PLACES.fullmatch(name) is None:
            raise RunError(f"{name!r} cannot be published; names may hold the letters A-Z, a-z, 0-9, '.', '_' and '-'")
    lines = [f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in sorted(members.items())]
    manifest = "".join(lines).encode()
    return packed({**members, MANIFEST: manifest}), hashlib.sha256(manifest).hexdigest()


def _unpacked(source: Path, folder: Path) -> Opened:
    """Unpack and verify a bundle."""
    budget = Budget(source, source.stat().st_size)
    digests = unpack(source, folder, _PLACES, budget)
    missing = sorted(_REQUIRED - digests.keys())
    if missing:
        raise BundleError(f"{source} lacks {', '.join(missing)}; it is no published run, or was damaged")
    digest = digests.pop(MANIFEST)
    _check_manifest(source, (folder / MANIFEST).read_text(encoding="utf-8", errors="replace"), digests)
    solid.unpack(folder / STORE, folder / "store", budget)
    run = folder / "run" / _name(folder / "run")
    (folder / "run").rename(folder / "moved")
    run.parent.mkdir()
    (folder / "moved").rename(run)  # tables and figures bear the name of the run's folder
    return Opened(run=run, store=folder / "store", root=folder, digest=digest)


def _check_manifest(source: Path, manifest: str, digests: Mapping[str, str]) -> None:
    """Hold the members against the manifest.

    Raises:
        BundleError: a member is not what it says, or one of the two has a member more.
    """
    listed: dict[str, str] = {}
    for number, line in enumerate(manifest.splitlines(), start=1):
        match = _MANIFEST_LINE.fullmatch(line)
        if match is None or match[2] in listed:
            raise BundleError(f"{source}: {MANIFEST}, line {number} is no digest of a member, or one given twice")
        listed[match[2]] = match[1]
    for name in sorted(listed.keys() | digests.keys()):
        if name not in digests:
            raise BundleError(f"{source}: {name!r} stands in {MANIFEST} but is not there")
        if name not in listed:
            raise BundleError(f"{source}: {name!r} is there but does not stand in {MANIFEST}")
        if listed[name] != digests[name]:
            raise BundleError(f"{source}: {name!r} is not what {MANIFEST} says: it was edited or damaged")


def _name(run: Path) -> str:
    """Read the name of a run, which becomes that of a folder."""
    directory = RunDirectory(run)
    try:
        with directory.believed():
            name = directory.read_run()["name"]
    except RunError as error:
        raise BundleError(str(error)) from error
    if (
        not (isinstance(name, str) and name.isprintable())
        or "/" in name
        or name in {"", ".", ".."}
        or len(name.encode()) > 255
    ):
        raise BundleError(f"{run}/run.json: the name of a run must be that of a folder; got {json.dumps(name)[:100]}")
    return name
