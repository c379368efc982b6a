"""A published run, or a sweep of runs: one zip file with their directories, store entries, studies, tables and figures.

docs/publishing.md describes it member by member. What reading promises: every member is where it belongs and is what
the manifest says, and there is no other. What it does not: a manifest can be written again after an edit, so only a
replay (`tacevo.bundles.verify`) shows whether the records follow from each other.
"""

import contextlib
import hashlib
import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from tacevo.bundles.texts import check_papers
from tacevo.errors import BundleError, CacheMissError, DivergenceError, RunError, TacevoError
from tacevo.storage.entries import CANDIDATES, ReadBudget, unpack_in_memory
from tacevo.storage.ledger import broken_line
from tacevo.storage.members import Member, Tree, as_tree
from tacevo.storage.notes import NOTE, read_note
from tacevo.storage.run_directory import MANIFEST, PARTS
from tacevo.storage.store import Entry
from tacevo.storage.zipfiles import LONGEST_NAME, packed, read_members

#: The store entries (`tacevo.storage.entries`).
STORE = "store.jsonl.xz"

#: The files that describe the bundle to people and to archives.
PAPERS = ("CITATION.cff", "LICENSE.txt", "README.md", "ro-crate-metadata.json")

#: A run's own files.
RUN_FILES = (NOTE, "archive.json", "ledger.jsonl", "prompts.json", "run.json", "summary.md", "timings.jsonl")

#: The environment, where it was known.
LOCK = "requirements.lock"

#: The files of a run that a bundle may lack.
_OPTIONAL = {NOTE, "timings.jsonl"}

#: The directory of a sweep, and what it holds beside its runs.
SWEEP = "sweep"

JOBS = f"{SWEEP}/sweep.json"

#: The note that the makers of a sweep wrote on it; a bundle may lack it.
SWEEP_NOTE = f"{SWEEP}/{NOTE}"

#: Members of every bundle.
_ALWAYS = {MANIFEST, STORE, *PAPERS}

_WORD = r"[A-Za-z0-9][A-Za-z0-9._-]*"

#: The pattern for the names of a part, of its packages and modules; a bundle holds no file that a run passes over
#: (`RunDirectory.read_part`).
_NAME = r"(?!__pycache__/)[A-Za-z_][A-Za-z0-9_-]*"

_CANDIDATE = r"g[0-9]+s[0-9]+\.(py|rejected\.txt)"

#: The name of every member: those of one run lie in `run`, those of a sweep's runs in the directories of its jobs.
_PLACES = re.compile(
    "|".join(map(re.escape, sorted({LOCK, JOBS, SWEEP_NOTE} | _ALWAYS)))
    + rf"|(run|{SWEEP}/(?!sweep\.json/|{re.escape(NOTE)}/){_WORD})/("
    + "|".join(map(re.escape, RUN_FILES))
    + rf"|candidates/{_CANDIDATE}"
    + rf"|studies/{_WORD}/(study\.json|scores\.jsonl)"
    + rf"|{PARTS}/{_NAME}/({_NAME}/)*{_NAME}\.py)"
    + rf"|tables/(more/)?({_WORD}/)?{_WORD}\.(csv|md|tex)"
    + rf"|figures/({_WORD}/)?{_WORD}\.pdf"
)

_OF_A_JOB = re.compile(rf"{SWEEP}/(?P<job>{_WORD})/candidates/(?P<name>{_CANDIDATE})")

#: The remedy for an entry that is missing.
_INCOMPLETE = "fetch the bundle again: an entry that its replay reads was removed, or this version asks otherwise"

_MANIFEST_LINE = re.compile(r"([0-9a-f]{64})  ([^\x00-\x1f\x7f]+)")


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


def read_bundle(source: Path) -> tuple[Member, Member, str]:
    """Read a bundle, and compare it with its manifest; nothing is written.

    Returns:
        The directory of all members, with the candidates' files that a sweep's store holds; that of its store entries;
        and the SHA-256 of its manifest, which is its digest.

    Raises:
        BundleError: it is damaged, or holds what none should; the message names the place.
    """
    budget = ReadBudget(source, source.stat().st_size)
    with refusing():
        members = read_members(source, _PLACES, budget)
        digests = {name: hashlib.sha256(data).hexdigest() for name, data in members.items()}
        _check_layout(source, digests)
        digest = digests.pop(MANIFEST)
        _check_manifest(source, members, digests)
        tree = as_tree(members)
        root = Member(str(source), tree, between=", ")
        check_papers(root)
        for name in digests:
            if name.endswith(f"/{NOTE}"):
                read_note((root / name).parent)  # refused here, and not by each command that shows it
        store, candidates = unpack_in_memory(root / STORE, budget)
        for entry in candidates:
            _add_candidate(entry, tree, str(root / STORE))
    return root, store, digest


def candidate_entry(job: str, name: str, text: str) -> Entry:
    """Return the entry that holds a candidate's file of a sweep's job."""
    return Entry(kind=CANDIDATES, request={"file": f"{SWEEP}/{job}/candidates/{name}"}, answer={"text": text})


def _add_candidate(entry: Entry, tree: Tree, place: str) -> None:
    """Put the file that `candidate_entry` packed beside its ledger."""
    asked, told = (value if isinstance(value, dict) else {} for value in (entry.request, entry.answer))
    file = str(asked.get("file"))[:LONGEST_NAME]
    text, match, sweep = str(told.get("text")), _OF_A_JOB.fullmatch(file), tree.get(SWEEP)
    job = sweep.get(match["job"]) if match and isinstance(sweep, dict) else None
    candidates = job.setdefault("candidates", {}) if isinstance(job, dict) else None
    is_ours = match is not None and entry == candidate_entry(match["job"], match["name"], text)
    if match is None or not is_ours or not isinstance(candidates, dict) or match["name"] in candidates:
        raise BundleError(repr(file), place=place, expected="files of a sweep's candidates, each once")
    candidates[match["name"]] = text.encode()


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
        is_miss = isinstance(error, CacheMissError)  # its user has no other store, and records nothing
        remedy = _INCOMPLETE if is_miss else "fetch the file again"
        raise BundleError(error.got, place=error.place, expected=error.expected, remedy=remedy) from error


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


def _check_manifest(source: Path, members: Mapping[str, bytes], digests: Mapping[str, str]) -> None:
    """Compare the members with the manifest."""
    manifest = members[MANIFEST].decode(errors="replace")
    listed: dict[str, str] = {}
    for number, line in enumerate(manifest.removesuffix("\n").split("\n"), start=1):
        match = _MANIFEST_LINE.fullmatch(line)
        if match is None or match[2] in listed:
            place = f"{source}, {MANIFEST}, line {number}"
            got = repr(line[:100]) if match is None else f"{match[2]!r} a second time"
            raise BundleError(got, place=place, expected="the digest and the name of a member, each once")
        listed[match[2]] = match[1]
    for name in sorted(listed.keys() | digests.keys()):
        if listed.get(name) != digests.get(name):
            edited = "was edited or damaged" if name in listed else "is not listed"
            line = broken_line(members[name]) if name in digests and name.endswith(".jsonl") else ""
            got = f"{name!r}{f', {line},' if line else ''} {edited if name in digests else 'is missing'}"
            raise BundleError(got, place=str(source), expected=f"the files that {MANIFEST} lists")
    if manifest != _manifest(digests):
        got = "the same digests in another text"
        raise BundleError(got, place=f"{source}, {MANIFEST}", expected="a line for each member, in their order")
