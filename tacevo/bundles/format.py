"""A published run, or a sweep of runs: one zip file with their directories, store entries, studies, tables and figures.

docs/publishing.md describes it member by member. What unpacking promises: every member is where it belongs and is what
the manifest says, and there is no other. What it does not: a manifest can be written again after an edit, so only a
replay (`tacevo.bundles.verify`) shows whether the records follow from each other.
"""

import contextlib
import hashlib
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from tacevo.bundles.texts import check_papers
from tacevo.bundles.zipfiles import LONGEST_NAME, packed, unpack
from tacevo.errors import BundleError, DivergenceError, RunError, TacevoError
from tacevo.records import Record
from tacevo.storage import entries
from tacevo.storage.canonical import canonical
from tacevo.storage.entries import CANDIDATES, Budget
from tacevo.storage.notes import NOTE, read_note
from tacevo.storage.run_directory import MANIFEST
from tacevo.storage.store import Entry
from tacevo.typed import convert

#: The store entries (`tacevo.storage.entries`).
STORE = "store.jsonl.xz"

#: What describes the bundle to people and to archives.
PAPERS = ("CITATION.cff", "LICENSE.txt", "README.md", "ro-crate-metadata.json")

#: A run's own files.
RUN_FILES = (NOTE, "archive.json", "ledger.jsonl", "prompts.json", "run.json", "summary.md", "timings.jsonl")

#: The environment, where it was known.
LOCK = "requirements.lock"

#: Of a run's own files, those that a bundle may lack.
_OPTIONAL = {NOTE, "timings.jsonl"}

#: The directory of a sweep, and what it holds beside its runs.
SWEEP = "sweep"

JOBS = f"{SWEEP}/sweep.json"

#: What the makers of a sweep say of it; a bundle may lack it.
SWEEP_NOTE = f"{SWEEP}/{NOTE}"

#: Members of every bundle.
_ALWAYS = {MANIFEST, STORE, *PAPERS}

_WORD = r"[A-Za-z0-9][A-Za-z0-9._-]*"

_CANDIDATE = r"candidates/g[0-9]+s[0-9]+\.(py|rejected\.txt)"

#: The name of every member: those of one run lie in `run`, those of a sweep's runs in the directories of its jobs.
_PLACES = re.compile(
    "|".join(map(re.escape, sorted({LOCK, JOBS, SWEEP_NOTE} | _ALWAYS)))
    + rf"|(run|{SWEEP}/(?!sweep\.json/|{re.escape(NOTE)}/){_WORD})/("
    + "|".join(map(re.escape, RUN_FILES))
    + rf"|{_CANDIDATE}"
    + rf"|studies/{_WORD}/(study\.json|scores\.jsonl))"
    + rf"|tables/{_WORD}\.(csv|md|tex)"
    + rf"|figures/{_WORD}\.pdf"
)

_OF_A_JOB = re.compile(rf"{SWEEP}/{_WORD}/{_CANDIDATE}")

_MANIFEST_LINE = re.compile(r"([0-9a-f]{64})  (.+)")


@dataclass(frozen=True, slots=True, kw_only=True)
class _File(Record):
    """Where a candidate's file of a sweep belongs."""

    file: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _Text(Record):
    """What is in it."""

    text: str


def sealed(members: Mapping[str, bytes]) -> tuple[bytes, str]:
    """Return the file of members that lack the manifest, and its digest; equal members give equal bytes.

    Raises:
        RunError: a member's name is not one that a bundle may have, e.g. because a task's name holds strange letters.
    """
    for name in members:
        if _PLACES.fullmatch(name) is None:
            raise RunError(repr(name), expected="names with the letters A-Z, a-z, 0-9, '.', '_' and '-' only")
    manifest = _manifest({name: hashlib.sha256(data).hexdigest() for name, data in members.items()}).encode()
    return packed({**members, MANIFEST: manifest}), hashlib.sha256(manifest).hexdigest()


def _manifest(digests: Mapping[str, str]) -> str:
    return "".join(f"{digest}  {name}\n" for name, digest in sorted(digests.items()))


def unpack_verified(source: Path, folder: Path) -> str:
    """Unpack a bundle into an empty directory, its store entries into `store`; return its digest.

    It is compared with its manifest. The caller removes the directory, also if this fails.

    Raises:
        BundleError: it is damaged, or holds what none should; the message names the place.
    """
    budget = Budget(source, source.stat().st_size)
    with refusing():
        digests = unpack(source, folder, _PLACES, budget)
        _check_layout(source, digests)
        digest = digests.pop(MANIFEST)
        _check_manifest(source, (folder / MANIFEST).read_bytes().decode(errors="replace"), digests)
        check_papers(folder)
        for name in digests:
            if name.endswith(f"/{NOTE}"):
                read_note((folder / name).parent)  # refused here, and not by each command that shows it
        for entry in entries.unpack(folder / STORE, budget):  # files need not survive a crash
            if entry.kind == CANDIDATES:
                _write_candidate(entry, folder)
                continue
            path = folder / "store" / entry.place
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(canonical(entry.sealed()), encoding="utf-8")
    return digest


def candidate_entry(job: str, name: str, text: str) -> Entry:
    """Return the entry that holds a candidate's file of a sweep's job."""
    return Entry(kind=CANDIDATES, request={"file": f"{SWEEP}/{job}/candidates/{name}"}, answer={"text": text})


def _write_candidate(entry: Entry, folder: Path) -> None:
    """Write the file that `candidate_entry` packed."""
    file = convert(_File, entry.request, place=f"{STORE}, request", error=BundleError).file
    is_known = len(file) <= LONGEST_NAME and _OF_A_JOB.fullmatch(file) and (folder / file).parent.parent.is_dir()
    if not is_known or (folder / file).exists():
        raise BundleError(repr(file[:LONGEST_NAME]), place=STORE, expected="files of a sweep's candidates, each once")
    text = convert(_Text, entry.answer, place=f"{STORE}, {file}", error=BundleError).text
    (folder / file).parent.mkdir(exist_ok=True)
    (folder / file).write_bytes(text.encode())


@contextlib.contextmanager
def refusing() -> Iterator[None]:
    """Refuse a bundle for anything that its readers cannot use; a difference stays a difference.

    Raises:
        BundleError: with the fields of the reader's error.
    """
    try:
        yield
    except (BundleError, DivergenceError):
        raise
    except TacevoError as error:
        raise BundleError(
            error.got, place=error.place, expected=error.expected, remedy="fetch the file again"
        ) from error


def _check_layout(source: Path, names: Collection[str]) -> None:
    """Check that every file that a bundle needs is there, and that it is either one run or a sweep."""
    is_sweep = any(name.startswith(f"{SWEEP}/") for name in names)
    runs = {name.split("/")[1] for name in names if name.startswith(f"{SWEEP}/") and name not in {JOBS, SWEEP_NOTE}}
    folders = [f"{SWEEP}/{run}" for run in sorted(runs)] if is_sweep else ["run"]
    needed = {f"{folder}/{name}" for folder in folders for name in set(RUN_FILES) - _OPTIONAL}
    missing = sorted((_ALWAYS | needed | ({JOBS} if is_sweep else set())) - set(names))
    if missing:
        got = f"a file without {', '.join(missing)}"
        raise BundleError(got, place=str(source), expected="a published run or sweep")
    foreign = sorted(name for name in names if is_sweep and name.startswith("run/"))
    if foreign:
        raise BundleError(repr(foreign[0]), place=str(source), expected="files of a published sweep only")


def _check_manifest(source: Path, manifest: str, digests: Mapping[str, str]) -> None:
    """Compare the members with the manifest."""
    listed: dict[str, str] = {}
    for number, line in enumerate(manifest.splitlines(), start=1):
        match = _MANIFEST_LINE.fullmatch(line)
        if match is None or match[2] in listed:
            place = f"{source}, {MANIFEST}, line {number}"
            got = repr(line[:100]) if match is None else f"{match[2]!r} a second time"
            raise BundleError(got, place=place, expected="the digest and the name of a member, each once")
        listed[match[2]] = match[1]
    for name in sorted(listed.keys() | digests.keys()):
        if listed.get(name) != digests.get(name):
            edited = "was edited or damaged" if name in listed else "is not listed"
            got = f"{name!r} {edited if name in digests else 'is missing'}"
            raise BundleError(got, place=str(source), expected=f"the files that {MANIFEST} lists")
    if manifest != _manifest(digests):
        got = "the same digests in another text"
        raise BundleError(got, place=f"{source}, {MANIFEST}", expected="a line for each member, in their order")
