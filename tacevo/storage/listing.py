"""`tacevo cache verify | import | prune`: what stores hold, whether it is sound, and what comes in from elsewhere."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tacevo.costs import in_words, spending_on
from tacevo.errors import StoreError
from tacevo.records import Completion, Request, Setting
from tacevo.storage.array_store import KIND, check_array
from tacevo.storage.canonical import content_hash, differences, shown
from tacevo.storage.places import sibling
from tacevo.storage.store import KINDS, Entry, check_entry, write_entry
from tacevo.text import counted, listed
from tacevo.typed import convert


@dataclass(frozen=True, slots=True, kw_only=True)
class Stored:
    """A file of a store: a sound entry, or what is wrong with it."""

    kind: str
    bytes: int
    #: The model that was asked for a completion, with which settings, and its answer; empty of another entry.
    model: str = ""
    settings: Mapping[str, Setting] = field(default_factory=dict)
    completion: Completion | None = None
    #: The error of a damaged file; None if it is sound.
    problem: StoreError | None = None


def scan(root: Path, kinds: Sequence[str] = KINDS) -> Iterator[Stored]:
    """Read every file of the stores, in the order of kinds and names; the rest of a killed writer is passed over."""
    for kind in kinds:
        for path in sorted((root / kind).rglob("*")):
            if not path.is_dir() and not path.name.endswith(".part"):
                yield _inspect(root, kind, path)


def describe_entries(root: Path, paths: Iterable[Path]) -> str:
    """Count some entries of the stores in a line, by kind, with their size and what answers among them were paid."""
    files = [_inspect(root, path.relative_to(root).parts[0], path) for path in paths]
    kinds = Counter(file.kind for file in files)
    size = sum(file.bytes for file in files)
    counts = [f"{kind} {count}" for kind, count in sorted(kinds.items())]
    damaged = sum(file.problem is not None for file in files)
    counts += [f"{damaged} of them damaged"] if damaged else []
    spent = spending_on([file.completion for file in files if file.completion is not None])
    answers = f"; of models {in_words(spent)}, to be paid again" if spent.answers else ""
    return f"{counted(len(files), 'file')} of {size / 1e6:.1f} MB ({listed(counts)}{answers})"


def verify(root: Path) -> tuple[list[str], int]:
    """Compare every entry with its checksum, its name and its question.

    Returns:
        What is wrong, one line for each damaged file, and the number of files.

    Raises:
        StoreError: the directory does not exist.
    """
    _check_folder(root)
    problems = [file.problem for file in scan(root)]  # the entries themselves would fill the memory
    return [str(problem) for problem in problems if problem], len(problems)


def _check_folder(root: Path) -> None:
    if not root.is_dir():
        expected, remedy = "the directory of stores", sibling(root, "name it by --store")
        raise StoreError("a path that is not one", place=str(root), expected=expected, remedy=remedy)


def _inspect(root: Path, kind: str, path: Path) -> Stored:
    """Check one file, and that it stands where an entry of its key stands."""
    size = 0
    try:
        data = path.read_bytes()
        size = len(data)
        entry = check_entry(path, data, kind, path.stem)
        if path != root / entry.place:
            got = str(path.relative_to(root))
            raise StoreError(got, place=str(path), expected=entry.place, remedy="move it, or delete it")
        request, completion = _checked_answer(path, entry)
        if request is None:
            return Stored(kind=kind, bytes=size)
        settings = dict(request.settings)
        return Stored(kind=kind, bytes=size, model=request.model, settings=settings, completion=completion)
    except StoreError as error:
        problem = error
    except OSError as error:
        problem = StoreError(str(error.strerror), place=str(path), expected="a file that can be read")
    return Stored(kind=kind, bytes=size, problem=problem)


def _checked_answer(path: Path, entry: Entry) -> tuple[Request | None, Completion | None]:
    """Check an answer by its kind; return the request and the answer of a completion, of another kind nothing.

    Raises:
        StoreError: its answer is not a completion, or its request is not a request, although the checksum is right; or
            it is an array, and not the one that its request names.
    """
    if entry.kind == KIND:
        check_array(entry, str(path))
    if entry.kind != "completions":
        return None, None
    answer = convert(Completion, entry.answer, place=f"{path}, answer", error=StoreError, remedy="delete it")
    request = convert(Request, entry.request, place=f"{path}, request", error=StoreError, remedy="delete it")
    return request, answer


def take_in(source: Path, entries: Iterable[Entry], root: Path) -> tuple[int, int]:
    """Write store entries from elsewhere into the stores; every one is verified before the first is written.

    `source` is where they come from, for messages.

    Returns:
        The number of entries that were written, and of those that stood there already.

    Raises:
        StoreError: an entry or its place in the stores is not as it should be; nothing was written.
    """
    verdicts = [(entry, _is_new(source, root, entry)) for entry in entries]
    new = [entry for entry, is_new in verdicts if is_new]
    for entry in new:
        write_entry(root, entry)
    return len(new), len(verdicts) - len(new)


def _is_new(source: Path, root: Path, entry: Entry) -> bool:
    """Verify an entry, and compare it with what stands in its place."""
    _checked_answer(source / entry.place, entry)
    target = root / entry.place
    if not target.resolve().is_relative_to(root.resolve()) or target.is_symlink():
        got = f"a link to {target.resolve()}"
        raise StoreError(got, place=str(target), expected=f"a file or a new place in {root}")
    if not target.exists():
        return True
    standing = check_entry(target, target.read_bytes(), entry.kind, entry.key)
    if content_hash(standing.answer) != content_hash(entry.answer):
        raise StoreError(
            f"an answer that differs in {shown(differences(entry.answer, standing.answer)[0])}",
            place=str(target),
            expected=f"no entry, or the answer that {source} holds",
            remedy="import into a store of its own (--store, or store.root of `tacevo extend`)",
        )
    return False
