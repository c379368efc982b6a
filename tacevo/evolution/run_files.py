"""The files of a search: its ledger with its header, and both archives.

ledger.jsonl    the header, then the lines of the search (`tacevo.evolution.lines`)
archive.json    the network archive, niche by niche
prompts.json    the prompt archive
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, TypeVar

from tacevo.errors import RunError
from tacevo.evolution.archive import AxisBounds
from tacevo.evolution.lines import CandidateLine, GenerationLine, SearchLine
from tacevo.records import DataFacts, Json, Operator, Record, written
from tacevo.rules import FIRST, Rules
from tacevo.storage.canonical import content_hash
from tacevo.storage.ledger import Sealed, read_lines
from tacevo.storage.run_directory import RunDirectory, RunRecord
from tacevo.text import counted
from tacevo.typed import FreeJson, parse

T = TypeVar("T")

NETWORKS, PROMPTS = "archive.json", "prompts.json"

#: A candidate: generation and slot.
_ID = re.compile("g[0-9]+s[0-9]+")

_REMEDY = "the command that began the run writes it again"


@dataclass(frozen=True, slots=True, kw_only=True)
class RunLine(Record):
    """The first line: all that the results of a run follow from."""

    #: Layout of the ledger.
    schema: int
    #: The part of the configuration that decides results (`tacevo.config.identity`).
    config: dict[str, FreeJson]
    #: SHA-256 of the task's texts.
    task: str
    data: DataFacts
    #: SHA-256 of the centroids of both archives.
    centroids: str
    rules: Rules = FIRST
    kind: Literal["run"] = "run"


Line = RunLine | SearchLine

_KINDS: Mapping[str, type[Line]] = {
    "run": RunLine,
    "candidate": CandidateLine,
    "generation": GenerationLine,
}


def line_kind(entry: Mapping[str, Json]) -> type[Line] | None:
    """Return the class of a line that is read as JSON; None where a search writes no such line.

    Raises:
        RunError: a search of an earlier release wrote it, by a setting that was removed.
    """
    if entry.get("kind") == "reevaluation":
        raise RunError(
            "an elite that was trained again, by archive.kind=extract, which was removed",
            expected="a line that this release writes",
            remedy="set archive.kind=cvt, and call `tacevo noise` after the search",
        )
    if entry.get("seeds"):
        raise RunError(
            "a candidate of several trainings, by training.seeds, which was removed",
            expected="a line that this release writes",
            remedy="leave training.seeds out, and call `tacevo noise` after the search",
        )
    return _KINDS.get(str(entry.get("kind")))


@dataclass(frozen=True, slots=True, kw_only=True)
class EliteEntry(Record):
    """An occupied niche, or place, of the network archive."""

    niche: int
    #: The centroid of the niche; None in an archive without niches.
    centroid: tuple[float, ...] | None = None
    id: str
    fitness: float
    #: The descriptors before normalisation.
    descriptors: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkArchiveFile(Record):
    """The content of archive.json."""

    niches: int
    coverage: float
    qd_score: float
    bounds: AxisBounds | None
    elites: tuple[EliteEntry, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialEntry(Record):
    """An occupied niche of the prompt archive."""

    niche: int
    centroid: tuple[float, ...]
    #: The id of the candidate, and of its instruction.
    id: str
    instruction: str
    prompt: int
    temperature: float
    inserted: bool
    curiosity: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PromptFile(Record):
    """The content of prompts.json."""

    niches: int
    coverage: float
    trials: tuple[TrialEntry, ...]


def read_ledger(directory: RunDirectory) -> Sealed[Line]:
    """Read the ledger of a run, checked; without lines where none was begun (`tacevo.storage.ledger.read_lines`)."""
    return read_lines(directory.ledger, line_kind)


def read_begun(directory: RunDirectory) -> RunRecord | None:
    """Read run.json; None where there is none.

    Raises:
        RunError: it is damaged or of another layout.
    """
    return directory.read_run() if (directory.path / "run.json").exists() else None


def is_finished(record: RunRecord | None, ledger: Sealed[Line]) -> bool:
    """Return whether a run is finished: run.json has the digest that the ledger ends with, on any machine."""
    return record is not None and record.digest is not None and record.digest == ledger.digest


def finished_digest(directory: RunDirectory) -> str | None:
    """Return the digest of a finished run; None where none was begun here, or the run did not come to its end.

    Raises:
        RunError: something of it was damaged or edited.
    """
    record = read_begun(directory)
    if record is None or record.digest is None:  # the ledger, which may be damaged, is not needed
        return None
    return record.digest if is_finished(record, read_ledger(directory)) else None


def read_finished(directory: RunDirectory) -> tuple[RunRecord, Sealed[Line]]:
    """Read run.json and the ledger of a finished run.

    Raises:
        RunError: it is not finished, or something of it was damaged or edited.
    """
    record, ledger = directory.read_run(), read_ledger(directory)
    if record.digest != ledger.digest or not any(isinstance(line, GenerationLine) for line in ledger.lines):
        raise RunError(
            "one that is not finished"
            if record.digest in {None, ledger.digest}
            else "one that is not finished, or was edited: "
            f"run.json has the digest {record.digest:.12}, and the ledger ends with {ledger.digest:.12}",
            place=str(directory.path),
            expected="a finished run",
            remedy="the command that began it continues it",
        )
    return record, ledger


def check_references(path: Path, record: RunRecord, lines: Sequence[Line]) -> None:
    """Check that candidates begin with the baseline, and that all lines name what comes earlier or is the task's.

    A replay finds every edit; this is for what reads a run without replaying it. Files are found by a candidate's id,
    which therefore is not a path. Generations are counted, because readers loop over them.

    Raises:
        RunError: one of them does not.
    """
    ids: set[str] = set()
    generation = 0
    for line in lines:
        if isinstance(line, CandidateLine):
            is_known = line.prompt is None or 0 <= line.prompt < len(record.task.instructions)
            is_there = line.operator is not Operator.given or 1 <= line.slot <= len(record.task.given)
            begins = bool(ids) or line.operator is Operator.baseline
            if not (_ID.fullmatch(line.id) and is_known and is_there and ids.issuperset(line.parents) and begins):
                raise RunError(
                    f"{line.id} with an unknown parent, instruction or network, with another id, or without a baseline "
                    "before it",
                    place=str(path),
                    expected="candidates that name earlier ones, and instructions and networks of the task",
                    remedy="restore the ledger",
                )
            ids.add(line.id)
        if not isinstance(line, RunLine) and line.generation != generation:
            got, expected = f"a line of generation {line.generation}", f"one of generation {generation}"
            raise RunError(got, place=str(path), expected=expected, remedy="restore the ledger")
        generation += isinstance(line, GenerationLine)


def rules_of(lines: Sequence[Line]) -> Rules:
    """Return the rules that a run was made under: those of its header.

    Raises:
        RunError: the ledger does not begin with a header, or has several.
    """
    headers = [index for index, line in enumerate(lines) if isinstance(line, RunLine)]
    if headers != [0] or not isinstance(lines[0], RunLine):
        got, expected = f"headers in lines {[index + 1 for index in headers]}", "one header, in the first line"
        raise RunError(got, place="ledger.jsonl", expected=expected)
    return lines[0].rules


def rules_in_words(rules: Rules) -> str:
    """Write the numbers of rules."""
    return ", ".join(f"{part} {number}" for part, number in asdict(rules).items())


def write_archives(directory: RunDirectory, files: tuple[NetworkArchiveFile, PromptFile]) -> None:
    """Write archive.json and prompts.json."""
    for name, file in zip((NETWORKS, PROMPTS), files, strict=True):
        directory.write_json(name, written(file))


def read_elites(directory: RunDirectory) -> tuple[EliteEntry, ...]:
    """Read the occupants of the network archive; none before the first generation is complete.

    Raises:
        RunError: archive.json is damaged.
    """
    return _read(directory, NETWORKS, NetworkArchiveFile).elites if (directory.path / NETWORKS).exists() else ()


def read_archive_files(directory: RunDirectory) -> tuple[NetworkArchiveFile, PromptFile]:
    """Read archive.json and prompts.json.

    Raises:
        RunError: a file is missing or damaged.
    """
    return _read(directory, NETWORKS, NetworkArchiveFile), _read(directory, PROMPTS, PromptFile)


def read_archives(directory: RunDirectory, last: GenerationLine) -> tuple[NetworkArchiveFile, PromptFile]:
    """Read archive.json and prompts.json of a finished run, and compare them with the last generation of its ledger.

    Raises:
        RunError: a file is missing or damaged, or is not what the ledger says: its occupants, or its bounds.
    """
    networks, prompts = read_archive_files(directory)
    elites: dict[str, Json] = {
        str(entry.niche): {"name": entry.id, "objective": -entry.fitness} for entry in networks.elites
    }
    trials: dict[str, Json] = {
        str(entry.niche): {name: getattr(entry, name) for name in ("prompt", "temperature", "inserted", "curiosity")}
        for entry in prompts.trials
    }
    _check(directory, NETWORKS, elites, len(networks.elites), last.archive)
    _check(directory, PROMPTS, trials, len(prompts.trials), last.prompt_archive)
    if networks.bounds != last.bounds:
        raise _misfit(directory, NETWORKS, "other bounds: it was edited")
    return networks, prompts


def _read(directory: RunDirectory, name: str, kind: type[T]) -> T:
    path = directory.path / name
    if not path.exists():
        raise _misfit(directory, name, "no file")
    return parse(kind, path.read_bytes(), place=str(path), error=RunError, remedy=_REMEDY)


def _check(directory: RunDirectory, name: str, occupants: dict[str, Json], count: int, recorded: str) -> None:
    """Compare the occupants of niches, and their number, with the hash that the ledger has of them."""
    if len(occupants) != count or content_hash(occupants) != recorded:
        raise _misfit(directory, name, f"{counted(count, 'occupant')} of another hash: it was edited")


def _misfit(directory: RunDirectory, name: str, got: str) -> RunError:
    return RunError(
        got,
        place=str(directory.path / name),
        expected="the archive that the ledger ends with",
        remedy=_REMEDY,
    )
