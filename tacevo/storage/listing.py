"""`tacevo cache ls | verify | explain`: what the stores hold, whether it is sound, and how two entries differ."""

import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tacevo.costs import Spending, in_words, spending_on, token_cells, total, usd
from tacevo.errors import StoreError
from tacevo.records import Completion, Json, Request
from tacevo.storage.arrays import KIND, check_array
from tacevo.storage.canonical import content_hash, differences, readable, shown, value_at
from tacevo.storage.files import write_durably
from tacevo.storage.store import KINDS, Entry, Store, check_entry, place_of, read_entry
from tacevo.text import counted, table
from tacevo.typed import convert

#: Fewest digits that name an entry.
_SHORTEST_KEY = 4

_NAME_IT = "name it by --store"

#: Longest text of a value that is shown.
_LONGEST_VALUE = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """A file of a store: a sound entry, or what is wrong with it."""

    kind: str
    path: Path
    bytes: int
    #: None where the file is damaged.
    entry: Entry | None
    #: Of a completion: the model that was asked, and its answer.
    model: str = ""
    completion: Completion | None = None
    #: None if the file is sound.
    problem: StoreError | None = None


def scan(root: Path, kinds: Sequence[str] = KINDS) -> Iterator[Found]:
    """Read every file of the stores, in the order of kinds and names; the rest of a killed writer is passed over."""
    for kind in kinds:
        for path in sorted((root / kind).rglob("*")):
            if not path.is_dir() and not path.name.endswith(".part"):
                yield _inspect(root, kind, path)


def list_stores(root: Path, *, kind: str | None, model: str | None) -> str:
    """Count the entries of the stores by kind and model, with sizes, tokens and costs.

    With `model`, only completions of models whose name contains it.

    Raises:
        StoreError: the directory does not exist.
    """
    _check_folder(root)
    chosen = KINDS if kind is None else (kind,)
    groups: dict[tuple[str, str], list[tuple[int, Spending]]] = defaultdict(list)
    for found in scan(root, chosen if model is None else ("completions",)):
        name = found.model if found.entry else "(damaged)"
        if model is None or model in name:
            spent = spending_on([] if found.completion is None else [found.completion])
            groups[found.kind, name].append((found.bytes, spent))
    rows = [_row(*key, files) for key, files in sorted(groups.items())]
    header = ["kind", "model", "entries", "size", "input tokens", "output tokens", "cost"]
    return table(header, rows) if rows else f"no such entries in {root}"


def verify(root: Path) -> tuple[list[str], int]:
    """Compare every entry with its checksum, its name and its question.

    Returns:
        What is wrong, one line for each damaged file, and the number of files.

    Raises:
        StoreError: the directory does not exist.
    """
    _check_folder(root)
    problems = [found.problem for found in scan(root)]  # the entries themselves would fill the memory
    return [str(problem) for problem in problems if problem], len(problems)


def explain(root: Path, prefix: str) -> str:
    """Describe an entry, and how it differs from the nearest other recording of its kind.

    Args:
        root: the directory of the stores.
        prefix: the first digits of its key.

    Raises:
        StoreError: no entry, or more than one, begins with these digits; or it is damaged.
    """
    _check_folder(root)
    path = _find(root, prefix)
    entry = read_entry(path)
    lines = [f"{entry.kind} {entry.key}: recorded in {path}", *_answered(path, entry)]
    parts = entry.request if isinstance(entry.request, Mapping) else {}
    lines += [f"  {name}: {_brief(value)}" for name, value in sorted(parts.items())]
    return "\n".join([*lines, _nearest(root, entry.kind, entry.request)])


def _check_folder(root: Path) -> None:
    if not root.is_dir():
        raise StoreError("a path that is not one", place=str(root), expected="the directory of stores", remedy=_NAME_IT)


def _inspect(root: Path, kind: str, path: Path) -> Found:
    """Check one file, and that it stands where an entry of its key stands."""
    size = 0
    try:
        data = path.read_bytes()
        size = len(data)
        entry = check_entry(path, data, kind, path.stem)
        if path != root / entry.place:
            got = str(path.relative_to(root))
            raise StoreError(got, place=str(path), expected=entry.place, remedy="move it, or delete it")
        model, completion = _checked_answer(path, entry)
        return Found(kind=kind, path=path, bytes=size, entry=entry, model=model, completion=completion)
    except StoreError as error:
        problem = error
    except OSError as error:
        problem = StoreError(str(error.strerror), place=str(path), expected="a file that can be read")
    return Found(kind=kind, path=path, bytes=size, entry=None, problem=problem)


def _checked_answer(place: Path, entry: Entry) -> tuple[str, Completion | None]:
    """Check an answer by its kind; return the model and the answer of a completion, of another kind nothing.

    Raises:
        StoreError: its answer is not a completion, or its request is not a request, although the checksum is right; or
            it is an array, and not the one that its request names.
    """
    if entry.kind == KIND:
        check_array(entry, str(place))
    if entry.kind != "completions":
        return "", None
    answer = convert(Completion, entry.answer, place=f"{place}, answer", error=StoreError, remedy="delete it")
    request = convert(Request, entry.request, place=f"{place}, request", error=StoreError, remedy="delete it")
    return request.model, answer


def _row(kind: str, model: str, files: Sequence[tuple[int, Spending]]) -> list[str]:
    spent = total(spent for _, spent in files)
    tokens = [*token_cells(spent), usd(spent)] if spent.answers else ["", "", ""]
    return [kind, model, str(len(files)), f"{sum(size for size, _ in files) / 1e6:.2f} MB", *tokens]


def _find(root: Path, prefix: str) -> Path:
    """Find the one entry whose key begins with a text."""
    hexadecimal = len(prefix) >= _SHORTEST_KEY and set(prefix.lower()) <= set("0123456789abcdef")
    if not hexadecimal:
        raise StoreError(prefix, expected=f"at least {_SHORTEST_KEY} hexadecimal digits of a key")
    paths = [path for kind in KINDS for path in root.glob(place_of(kind, f"{prefix.lower()}*"))]
    if len(paths) != 1:
        raise StoreError(
            f"{len(paths)}",
            place=str(root),
            expected=f"one entry whose key begins with {prefix}",
            remedy="give more digits",
        )
    return paths[0]


def _answered(path: Path, entry: Entry) -> list[str]:
    """Describe a completion's answer; those of other kinds are readable in their files."""
    _, completion = _checked_answer(path, entry)
    if completion is None:
        return []
    dropped = f", sent without {', '.join(completion.dropped)}" if completion.dropped else ""
    where = ", another server gave this name" if completion.elsewhere else ""
    return [
        f"  answered by {completion.model or 'an unnamed model'} ({completion.delivery}{where}{dropped}), ended by "
        f"{completion.stop_reason}, {in_words(spending_on([completion])).partition(', ')[2]}"
    ]


def _nearest(root: Path, kind: str, request: Json) -> str:
    """Say which other recording comes nearest, and every field in which it differs."""
    found = Store(root, kind).nearest(request)
    if found is None:
        return f"{root} holds no other recording of {kind}"
    entry, fields = found
    lines = [f"nearest other recording: {entry.key}; it differs in {counted(len(fields), 'field')}:"]
    for field in fields:
        was, now = (_brief(value_at(each, field)) for each in (entry.request, request))
        lines.append(f"  {shown(field)}: recorded {was}, here {now}")
    return "\n".join(lines)


def _brief(value: Json) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _LONGEST_VALUE else f"{text[: _LONGEST_VALUE - 3]}... ({len(text)} characters)"


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
        write_durably(root / entry.place, readable(entry.sealed()))
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
            remedy="import into a store of its own (--store, or store.root of `tacevo continue`)",
        )
    return False
