"""`tacevo cache ls | verify | explain`: what lies in the stores, whether it is sound, and how two requests differ."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tacevo.costs import Spending, spending_on, total, usd
from tacevo.errors import ConfigError, StoreError
from tacevo.records import Completion, Json, Request
from tacevo.storage.canonical import content_hash, shown, value_at
from tacevo.storage.files import write_durably
from tacevo.storage.store import KINDS, Store, check_entry
from tacevo.text import counted, table
from tacevo.typed import convert

#: Fewest digits that name an entry.
_SHORTEST_KEY = 4

#: Longest text of a value that is shown.
_LONGEST_VALUE = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """A file of a store: a sound entry, or what is wrong with it."""

    kind: str
    path: Path
    #: None where the file is damaged.
    entry: Mapping[str, Json] | None
    #: Empty where it is sound.
    problem: str
    bytes: int


_NOTHING = Spending()


@dataclass(frozen=True, slots=True, kw_only=True)
class Tally:
    """Files of one kind and model."""

    entries: int = 0
    bytes: int = 0
    spent: Spending = _NOTHING

    def plus(self, other: Tally) -> Tally:
        """Add up."""
        return Tally(
            entries=self.entries + other.entries,
            bytes=self.bytes + other.bytes,
            spent=total([self.spent, other.spent]),
        )


def scan(root: Path, kinds: Sequence[str] = KINDS) -> Iterator[Found]:
    """Read every file of the stores, in the order of kinds and names; what a killed writer left is passed over."""
    for kind in kinds:
        for path in sorted((root / kind).rglob("*")):
            if not path.is_dir() and not path.name.endswith(".part"):
                yield _inspect(root, kind, path)


def list_stores(root: Path, *, kind: str | None, model: str | None) -> str:
    """Count the entries of the stores by kind and model, with sizes, tokens and costs.

    Args:
        root: the folder of the stores.
        kind: only this one.
        model: only completions of models whose name contains this.

    Raises:
        StoreError: there is no such folder.
    """
    _insist(root)
    chosen = KINDS if kind is None else (kind,)
    groups: dict[tuple[str, str], Tally] = defaultdict(Tally)
    for found in scan(root, chosen if model is None else ("completions",)):
        name = _model(found)
        if model is None or model in name:
            groups[found.kind, name] = groups[found.kind, name].plus(_tallied(found))
    rows = [_row(*key, tally) for key, tally in sorted(groups.items())]
    header = ["kind", "model", "entries", "size", "input tokens", "output tokens", "cost"]
    return table(header, rows) if rows else f"no such entries in {root}"


def verify(root: Path) -> tuple[list[str], int]:
    """Hold every entry against its checksum, its name and its question.

    Returns:
        What is wrong, a line a file, and the number of files.

    Raises:
        StoreError: there is no such folder.
    """
    _insist(root)
    problems = [found.problem for found in scan(root)]  # the entries themselves would fill the memory
    return [problem for problem in problems if problem], len(problems)


def explain(root: Path, what: str) -> str:
    """Say what an entry is, or what a request is not, and how it differs from the nearest recording.

    Args:
        root: the folder of the stores.
        what: the first digits of a key; or a JSON file with a completion's request, or with a `kind` and a `request`.

    Raises:
        StoreError: no entry, or more than one, begins with these digits; or it is damaged.
        ConfigError: the file cannot be read.
    """
    _insist(root)
    if Path(what).is_file():
        kind, request = _asked(Path(what))
        store = Store(root, kind)
        key = store.key(request)
        if not store.holds(key):
            return "\n".join([f"{kind} {key}: not recorded", _nearest(root, kind, request)])
        _, entry = _sound(root, key)
        return "\n".join([f"{kind} {key}: recorded", *_answered(kind, entry["answer"]), _nearest(root, kind, request)])
    found, entry = _sound(root, what)
    lines = [f"{found.kind} {entry['key']}: recorded in {found.path}", *_answered(found.kind, entry["answer"])]
    lines += [f"  {name}: {_brief(value)}" for name, value in sorted(entry["request"].items())]
    return "\n".join([*lines, _nearest(root, found.kind, entry["request"])])


def _sound(root: Path, digits: str) -> tuple[Found, Mapping[str, Json]]:
    """Read the one entry whose key begins with some digits; a damaged one is refused."""
    found = _entry(root, digits)
    if found.entry is None:
        raise StoreError(found.problem)
    return found, found.entry


def _insist(root: Path) -> None:
    if not root.is_dir():
        raise StoreError(f"{root} is no folder of stores; name it by --store")


def _inspect(root: Path, kind: str, path: Path) -> Found:
    """Check one file, and that it stands where an entry of its key stands."""
    entry, problem, size = None, "", 0
    try:
        data = path.read_bytes()
        size = len(data)
        entry = check_entry(path, data, kind, path.stem)
        if kind == "completions":
            check_completion(path, entry)
    except StoreError as error:
        entry, problem = None, str(error)
    except OSError as error:
        problem = f"{path} cannot be read: {error.strerror}"
    if entry is not None and path != root / kind / path.stem[:2] / f"{path.stem}.json":
        entry, problem = None, f"{path} is not where an entry of its key belongs; move it, or delete it"
    return Found(kind=kind, path=path, entry=entry, problem=problem, bytes=size)


def check_completion(path: Path, entry: Mapping[str, Json]) -> Completion:
    """Read an entry among the completions; its checksum is right, but this version may not know its fields.

    Args:
        path: where it stands, for messages.
        entry: what `check_entry` returned.

    Raises:
        StoreError: its request is not a request, or its answer is not a completion.
    """
    convert(Request, entry["request"], place=f"{path}, request", error=StoreError, remedy="delete the file")
    return convert(Completion, entry["answer"], place=f"{path}, answer", error=StoreError, remedy="delete the file")


def _model(found: Found) -> str:
    """Name the model of a completion as it was asked for; nothing for other kinds."""
    if found.entry is None:
        return "(damaged)"
    return str(found.entry["request"]["model"]) if found.kind == "completions" else ""


def _tallied(found: Found) -> Tally:
    """Count one file; only completions cost money."""
    spent = Spending()
    if found.kind == "completions" and found.entry is not None:
        spent = spending_on([check_completion(found.path, found.entry)])
    return Tally(entries=1, bytes=found.bytes, spent=spent)


def _row(kind: str, model: str, tally: Tally) -> list[str]:
    spent = tally.spent
    tokens = [f"{spent.input_tokens:,}", f"{spent.output_tokens:,}", usd(spent)] if spent.answers else ["", "", ""]
    return [kind, model, str(tally.entries), f"{tally.bytes / 1e6:.2f} MB", *tokens]


def _entry(root: Path, prefix: str) -> Found:
    """Find the one entry whose key begins with a text."""
    hexadecimal = len(prefix) >= _SHORTEST_KEY and set(prefix.lower()) <= set("0123456789abcdef")
    if not hexadecimal:
        raise StoreError(
            f"{prefix} is neither a file nor a key; give a JSON file with a request, or at least {_SHORTEST_KEY} "
            "hexadecimal digits of a key"
        )
    folder = prefix.lower()[:2]
    paths = [(kind, path) for kind in KINDS for path in sorted((root / kind / folder).glob(f"{prefix.lower()}*.json"))]
    if len(paths) != 1:
        count = "no entry" if not paths else f"{len(paths)} entries"
        raise StoreError(
            f"{count} in {root} with a key that begins with {prefix}; give more digits, or the request as a JSON file"
        )
    kind, path = paths[0]
    return _inspect(root, kind, path)


def _asked(path: Path) -> tuple[str, Json]:
    """Read a request from a file: the request alone, or a mapping with its kind, such as a store's entry."""
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
        content_hash(value)  # NaN and half characters, which no request holds
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is no JSON file with a request: {error}") from error
    if not isinstance(value, dict) or not isinstance(value.get("request", {}), dict):
        raise ConfigError(f"{path} needs a JSON object with a request; got {_brief(value)}")
    if "request" not in value:
        return "completions", value
    kind = value.get("kind", "completions")
    if kind not in KINDS:
        raise ConfigError(f"{path} names the kind {kind!r}; there are {', '.join(KINDS)}")
    return kind, value["request"]


def _answered(kind: str, answer: Json) -> list[str]:
    """Describe a completion's answer; those of other kinds speak for themselves in their files."""
    if kind != "completions":
        return []
    completion = convert(Completion, answer, place="answer", error=StoreError)
    dropped = f", sent without {', '.join(completion.dropped)}" if completion.dropped else ""
    return [
        f"  answered by {completion.model} ({completion.delivery}{dropped}), ended by {completion.stop_reason}, "
        f"{completion.input_tokens:,} + {completion.output_tokens:,} tokens, {usd(spending_on([completion]))}"
    ]


def _nearest(root: Path, kind: str, request: Json) -> str:
    """Say which other recording comes nearest, and every field in which it differs."""
    found = Store(root, kind).nearest(request)
    if found is None:
        return f"there is no other recording of {kind} in {root}"
    entry, fields = found
    lines = [f"nearest other recording: {entry['key']}; it differs in {counted(len(fields), 'field')}:"]
    for field in fields:
        was, now = (_brief(value_at(each, field)) for each in (entry["request"], request))
        lines.append(f"  {shown(field)}: recorded {was}, here {now}")
    return "\n".join(lines)


def _brief(value: Json) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _LONGEST_VALUE else f"{text[: _LONGEST_VALUE - 3]}... ({len(text)} characters)"


def take_in(source: Path, entries: Mapping[str, bytes], root: Path) -> tuple[int, int]:
    """Write store entries from elsewhere into the stores; every one is verified before the first is written.

    Args:
        source: where they come from, for messages.
        entries: by their places in the stores, e.g. `probes/0a/0a....json`.
        root: the folder of the stores.

    Returns:
        The number of entries that were written, and of those that stood there already.

    Raises:
        StoreError: an entry or its place in the stores is not as it should be; nothing was written.
    """
    new = {name: data for name, data in entries.items() if _is_new(source, root, name, data)}
    for name, data in new.items():
        write_durably(root / name, data)
    return len(new), len(entries) - len(new)


def _is_new(source: Path, root: Path, name: str, data: bytes) -> bool:
    """Verify a member, and hold it against what stands in its place."""
    kind, _, file = name.split("/")
    entry = check_entry(source / name, data, kind, file.removesuffix(".json"))
    if kind == "completions":
        check_completion(source / name, entry)
    target = root / name
    if not target.resolve().is_relative_to(root.resolve()) or target.is_symlink():
        raise StoreError(f"{target} leads out of {root} by a link; nothing is written there")
    if not target.exists():
        return True
    standing = check_entry(target, target.read_bytes(), kind, file.removesuffix(".json"))
    if content_hash(standing) != content_hash(entry):
        raise StoreError(
            f"{target} has another answer than {source}; import into a store of its own (--store, or "
            "store.root of `tacevo continue`)"
        )
    return False
