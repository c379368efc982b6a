"""A run directory: what one run leaves behind, readable with `ls` and `cat`.

run.json        the resolved configuration, the task's texts, data facts, versions, machine, digest, and what
                confined the candidates
ledger.jsonl    every decision, one line each (tacevo.storage.ledger)
timings.jsonl   wall times and costs, which no ledger may hold
archive.json    the network archive, niche by niche
prompts.json    the prompt archive
candidates/     the source of every admitted candidate, and the answer and the reason behind every rejected one
parts/          the sources of the parts that a user brought and that decided
summary.md      what was found
NOTE.md         what readers must know, if somebody wrote it (tacevo.storage.notes)
"""

import contextlib
import hashlib
import os
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from annotated_types import Ge

from tacevo.costs import Spending
from tacevo.environment import Code
from tacevo.errors import RunError
from tacevo.parts.kinds import MOST_BYTES, MOST_FILES
from tacevo.records import DataFacts, Json, Record, Rejection, Task, to_json, written
from tacevo.rules import FIRST_PAGES
from tacevo.storage.canonical import canonical, readable, value_at
from tacevo.storage.files import is_in_use, locked, remove_leftovers, write_durably
from tacevo.storage.members import Member
from tacevo.typed import FreeJson, parse

#: A candidate's file holds its source, or the answer that was rejected.
_ENDINGS = {".py", ".rejected.txt"}

#: The directory of the sources of parts that a user brought: one for each, by its name.
PARTS = "parts"

_MAKES = "`tacevo search` makes one, and prints its name"

#: The file of a published run with the digests of all other files, in the form that `sha256sum --check` reads.
MANIFEST = "manifest-sha256.txt"


def name_instead(path: Path) -> str:
    """Return the remedy for the directory of an unpacked bundle: what a user names instead; empty for another one."""
    if not (path / MANIFEST).is_file():
        return ""
    name = "this is an unpacked bundle: name the file that `tacevo publish` wrote"
    if not (path / "run").is_dir():
        return f"{name}; the candidates of a sweep are in its store.jsonl.xz"
    return f"{name}, or {path}/run, whose stores `tacevo cache import {path}/store.jsonl.xz --store DIR` writes"


def runs_below(folder: Path) -> list[Path]:
    """List the directories of runs in a directory, itself among them, at any depth and behind links, too."""
    runs, seen = [], set()
    for path, folders, files in os.walk(folder, followlinks=True):
        real = os.path.realpath(path)
        if real in seen:  # a link to what is above it
            folders.clear()
        elif {"run.json", "ledger.jsonl"} <= set(files):
            runs.append(Path(path))
        seen.add(real)
    return sorted(runs)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunRecord(Record):
    """The content of run.json."""

    #: Layout of the file.
    schema: Literal[1] = 1
    name: str
    #: The configuration, as `tacevo.records.to_json` writes it.
    config: dict[str, FreeJson]
    task: Task
    data: DataFacts
    versions: dict[str, str]
    machine: dict[str, FreeJson]
    #: The commit of the code; None where the package was not run from a checkout, and in runs of the first release.
    code: Code | None = None
    #: Each way in which candidates were confined, in the order in which they came.
    confinement: tuple[dict[str, str], ...]
    #: The run's digest; None until it is finished.
    digest: str | None
    #: Number of the summary and the tables (`tacevo.rules.PAGES`).
    pages: int = FIRST_PAGES
    #: The trivial loss of the validation images (`tacevo.evolution.chance`); None in runs of earlier releases.
    trivial: Annotated[float, Ge(0)] | None = None
    #: Whether another server than the provider's own gave an answer, and so the model's name.
    elsewhere: bool = False

    LATER: ClassVar[frozenset[str]] = frozenset({"trivial", "elsewhere"})

    @property
    def is_of_given(self) -> bool:
        """Whether it holds given networks and no search, as a study of such networks makes it."""
        return bool(self.task.given) and not value_at(self.config, ("search", "generations"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing(Record):
    """A line of timings.jsonl: of a candidate, or of a generation."""

    id: str | None = None
    generation: int | None = None
    #: Wall time of gate and training.
    seconds: float | None = None
    #: Processor time of its trainings, as read outside the candidate's process; None where all were recalled.
    cpu_seconds: float | None = None
    answers: int
    input_tokens: int
    output_tokens: int
    usd: float
    unpriced: int
    uncounted: int = 0
    #: The time when the line was written, in ISO 8601 with a time zone.
    at: str

    @property
    def spent(self) -> Spending:
        """The cost of the answers."""
        return Spending(**{field.name: getattr(self, field.name) for field in fields(Spending)})


class RunDirectory:
    """Writes and reads the files of one run; the directory is made when something is written."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def ledger(self) -> Path:
        """The ledger's path."""
        return self.path / "ledger.jsonl"

    def locked(self) -> AbstractContextManager[None]:
        """Hold the directory for this process alone (see `tacevo.storage.files.locked`)."""
        return locked(self.path, "run.dir")

    @property
    def is_busy(self) -> bool:
        """Whether a process holds the directory at this moment; nobody writes into a bundle."""
        return not isinstance(self.path, Member) and is_in_use(self.path / ".lock", shared=True)

    def remove_leftovers(self) -> None:
        """Remove what killed writers left here."""
        remove_leftovers(self.path)

    def write_json(self, name: str, value: Json) -> None:
        """Write one of the JSON files whole."""
        write_durably(self.path / name, readable(value))

    def write_text(self, name: str, text: str) -> None:
        """Write one of the text files whole."""
        write_durably(self.path / name, text)

    def write_run(self, run: RunRecord) -> None:
        """Write run.json whole."""
        self.write_text("run.json", run_text(run))

    def read_run(self) -> RunRecord:
        """Read run.json.

        Raises:
            RunError: this is not a run directory, or run.json is damaged or of another layout.
        """
        path = self.path / "run.json"
        try:
            text = path.read_bytes()
        except OSError as error:
            is_file = self.path.is_file() or self.path.parent.is_file()
            got = "a file" if is_file else f"one whose run.json cannot be read ({error.strerror})"
            raise RunError(
                got if is_file or self.path.exists() else "a path that does not exist",
                place=str(self.path),
                expected="the directory of a run",
                remedy="unzip a published run, and name its directory run; of a sweep this cannot be"
                if is_file
                else name_instead(self.path) or _MAKES,
            ) from error
        remedy = "restore it, or delete it: the `tacevo search` command that began the run writes it again"
        return parse(RunRecord, text, place=str(path), error=RunError, remedy=remedy)

    def keep_candidate(self, name: str, source: str) -> None:
        """Keep the source of an admitted candidate."""
        self._keep(name, ".py", source)

    def keep_rejected(self, name: str, rejection: Rejection, answer: str) -> None:
        """Keep the answer behind a rejected candidate, under the reason."""
        self._keep(name, ".rejected.txt", rejected_text(rejection, answer))

    def keep_part(self, name: str, sources: Mapping[str, str]) -> None:
        """Keep the sources of a part that a user brought, by file; what was edited since is written again."""
        for file, text in sources.items():
            path = self.path / PARTS / name / file
            if not path.is_file() or path.read_bytes() != text.encode():
                write_durably(path, text)

    def read_part(self, name: str) -> dict[str, str] | None:
        """Read the sources of a part that a user brought, by file in order; None where there are none.

        What Python compiled there (`__pycache__`) and an empty directory are passed over; whatever else is no file of
        sources makes it another part: a link, which is not followed, since a run may be a stranger's, a pipe, or a file
        of more than `MOST_BYTES`. It is listed with a text that says so, and is never read.
        """
        texts: dict[str, str] = {}
        root = self.path / PARTS / name
        pending = [root]
        while pending and len(texts) <= MOST_FILES:
            path = pending.pop()
            file = path.relative_to(root).as_posix()
            if path.is_symlink():
                texts[file] = "a link"
            elif path.is_dir():
                pending += () if path.name == "__pycache__" else path.iterdir()
            elif path.is_file() and path.stat().st_size <= MOST_BYTES:
                texts[file] = path.read_bytes().decode(errors="replace")
            elif path.exists():
                texts[file] = "no file of sources, or too large a one"
        return {file: texts[file] for file in sorted(texts)} or None

    def read_kept(self, name: str) -> bytes | None:
        """Read a candidate's file, of either kind; None where there is none."""
        for ending in _ENDINGS:
            path = self.path / "candidates" / f"{name}{ending}"
            if path.is_file() and not path.is_symlink():  # a stranger's run must not show a file of this user
                return path.read_bytes()
        return None

    def read_checked(self, name: str, sha256: str | None) -> tuple[bytes | None, bool]:
        """Read a candidate's file, and say whether it is another source than the one whose hash its ledger line has.

        A rejected candidate has no hash (None), and a missing file was not edited.
        """
        kept = self.read_kept(name)
        return kept, None not in {kept, sha256} and hashlib.sha256(kept or b"").hexdigest() != sha256

    def read_source(self, name: str, sha256: str) -> str:
        """Read the source of an admitted candidate, whose hash its ledger line has.

        Raises:
            RunError: the file is missing, or is not what was admitted.
        """
        source, is_edited = self.read_checked(name, sha256)
        if source is None or is_edited:
            raise RunError(
                "no file" if source is None else "another source: the file was edited",
                place=f"{self.path}/candidates/{name}.py",
                expected=f"the source whose hash the ledger has, {sha256[:12]}",
                remedy="restore it",
            )
        return source.decode()

    def _keep(self, name: str, ending: str, text: str) -> None:
        """Write a candidate's file unless it stands there; one of another kind was left by a killed run."""
        directory = self.path / "candidates"
        for other in _ENDINGS - {ending}:
            (directory / f"{name}{other}").unlink(missing_ok=True)
        path = directory / f"{name}{ending}"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            write_durably(path, text)

    def add_timing(
        self,
        spent: Spending,
        *,
        id: str | None = None,
        generation: int | None = None,
        seconds: float | None = None,
        cpu_seconds: float | None = None,
    ) -> None:
        """Append a line to timings.jsonl, with the present time; a line torn by a kill is ended first.

        Raises:
            RunError: the disk is full or fails.
        """
        at = datetime.now(UTC).isoformat(timespec="milliseconds")
        timing = Timing(id=id, generation=generation, seconds=seconds, cpu_seconds=cpu_seconds, at=at, **asdict(spent))
        line = timing_text(timing)
        path = self.path / "timings.jsonl"
        try:
            with path.open("ab+") as file:
                file.seek(max(0, file.seek(0, os.SEEK_END) - 1))
                torn = file.read(1) not in (b"", b"\n")
                file.write((b"\n" if torn else b"") + line.encode())
        except OSError as error:
            raise RunError(
                f"{error.strerror}, while a line was written; the ledger is safe",
                place=str(path),
                remedy="make room, and run the same command again",
            ) from error

    def read_timings(self) -> list[Timing]:
        """Read timings.jsonl, without lines that were torn by a kill."""
        path, timings = self.path / "timings.jsonl", []
        for text in path.read_bytes().splitlines() if path.exists() else ():
            with contextlib.suppress(RunError):
                timings.append(parse(Timing, text, place=str(path), error=RunError))
        return timings

    def read_spending(self) -> dict[str, Spending]:
        """Read what each candidate's answers cost, by id; the last line of a candidate counts."""
        return {timing.id: timing.spent for timing in self.read_timings() if timing.id is not None}


class FinishedDirectory(RunDirectory):
    """The directory of a finished run, to which nobody writes: a candidate's file and the timings are read once."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._kept: dict[str, bytes | None] = {}
        self._timings: list[Timing] | None = None

    def read_kept(self, name: str) -> bytes | None:
        """Read a candidate's file, as `RunDirectory.read_kept`."""
        if name not in self._kept:
            self._kept[name] = super().read_kept(name)
        return self._kept[name]

    def read_timings(self) -> list[Timing]:
        """Read timings.jsonl, as `RunDirectory.read_timings`."""
        if self._timings is None:
            self._timings = super().read_timings()
        return self._timings


def run_text(run: RunRecord) -> str:
    """Write run.json."""
    return readable(to_json(run))


def timing_text(timing: Timing) -> str:
    """Write a line of timings.jsonl."""
    return f"{canonical(written(timing))}\n"


def rejected_text(rejection: Rejection, answer: str) -> str:
    """Write the answer behind a rejected candidate, under the reason."""
    return f"{rejection.stage}: {rejection.reason}: {rejection.detail}\n{'-' * 72}\n{answer}\n"
