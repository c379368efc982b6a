"""Write the JSON schema of every file that docs/formats.md describes, from the records that the package reads it by.

    python docs/site/schemas.py docs/schemas

A schema has what a record has: fields, types, ranges, defaults, and the comments beside them. A field with a default
may be absent, as it is in files of earlier releases. What a record checks beyond that, such as that groups are numbered
as they come, is in no schema.
"""

import json
import sys
from collections.abc import Iterator
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, Literal, NotRequired

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import core_schema
from typing_extensions import TypedDict  # as pydantic demands before Python 3.12

from tacevo.config.comments import comments_of
from tacevo.config.schema import PartCode
from tacevo.evolution.lines import CandidateLine, GenerationLine
from tacevo.evolution.run_files import NetworkArchiveFile, PromptFile, RunLine
from tacevo.profile import Profile
from tacevo.records import Completion, Contract, DataFacts, Limits, Recipe, Rejection, Request, Training
from tacevo.results.study_lines import FailedLine, ScoreLine, StudyHeader, StudyRecord
from tacevo.results.table_records import Header, TableNetwork, TableTraining
from tacevo.rules import Rules
from tacevo.storage.array_store import _Content, _Question
from tacevo.storage.entries import CANDIDATES, _Header
from tacevo.storage.plan_file import SeedPlan
from tacevo.storage.run_directory import RunRecord, Timing
from tacevo.storage.store import KINDS, Entry, _Sealed
from tacevo.storage.sweep_directory import Failure, SweepRecord
from tacevo.training.full import FullTraining

#: The hash of a line, or of the one before it.
_HASH = {"type": "string", "pattern": "^[0-9a-f]{64}$"}


class Extracted(TypedDict):
    """Asks what the gate takes from an answer."""

    version: int
    text: str
    stop_reason: str
    contract: Contract
    limit: int
    asked: NotRequired[str]
    own: NotRequired[bool]


class Sources(TypedDict):
    """The source that was taken, or why none was."""

    source: NotRequired[str]
    rejection: NotRequired[Rejection]


class Bounds(TypedDict):
    """The limits of a network's size."""

    parameters: int
    flops: int
    modules: int


class Probed(TypedDict):
    """Asks what a network is."""

    version: int
    source: str
    contract: Contract
    limits: Bounds
    probe_limits: Limits
    numerics: str
    data: NotRequired[str]


class Profiles(TypedDict):
    """What the probe measured, or why it refused the network."""

    profile: NotRequired[Profile]
    rejection: NotRequired[Rejection]


class Trained(TypedDict):
    """Asks how a training goes."""

    version: int
    source: str
    data: str
    contract: Contract
    recipe: Recipe
    seed: int
    numerics: str
    device: NotRequired[str]


class Trainings(TypedDict):
    """A training of a search, or why it failed."""

    training: NotRequired[Training]
    rejection: NotRequired[Rejection]


class FullTrainings(TypedDict):
    """A training of a study, or why it failed."""

    full: NotRequired[FullTraining]
    rejection: NotRequired[Rejection]


class Shape(TypedDict):
    """Asks where the niches of an archive are."""

    niches: int
    dimensions: int
    samples: int
    seed: int


class File(TypedDict):
    """Names the file of a candidate in the bundle of a sweep."""

    file: str


class Text(TypedDict):
    """The text of that file."""

    text: str


class Decision(TypedDict):
    """Asks what a part of a user decides: the hashes of its code and of what it is given."""

    part: str
    settings: dict[str, Any]
    method: str
    given: str


class ExportedTraining(TypedDict):
    """One training of an exported model."""

    seed: int
    epoch: int
    key: str
    weights_sha256_after_last_epoch: str
    was_recorded: bool
    differs_from_record: list[str] | None
    differs_from_other_training: list[str] | None


class ExportedRun(TypedDict):
    """run.json of an export: where the network comes from."""

    schema: Literal[1]
    run: str
    digest: str
    bundle: str | None
    candidate: str
    source_sha256: str
    task: str
    seed: int
    rules: Rules
    data: DataFacts
    like: Literal["study", "search"]
    study: str | None
    recipe: Recipe
    numerics: str
    trainings: list[ExportedTraining]
    not_promised: list[str]
    made_by: dict[str, Any]


class ExportedInput(TypedDict):
    """The images that an exported model takes."""

    layout: Literal["NCHW"]
    channels: Literal["RGB"]
    size: int
    range: tuple[int, int]
    resize: Literal["bilinear"]
    recorded_size: tuple[int, int] | None
    bits: list[int]
    white_point: float | None
    mean: list[float]
    deviation: list[float]


class ExportedOutputs(TypedDict):
    """The outputs of an exported model; of a regression with unit, scale and offset of each."""

    kind: Literal["regression", "classification"]
    names: list[str]
    units: NotRequired[list[str]]
    scale: NotRequired[list[float]]
    offset: NotRequired[list[float]]


class Spread(TypedDict):
    """The quartiles of values, and how many they are."""

    median: float
    lower_quartile: float
    upper_quartile: float
    count: int


#: config.json of an export, in which `class` is no name of Python.
ExportedConfig = TypedDict(
    "ExportedConfig",
    {
        "class": str,
        "arguments": dict[str, int],
        "weights": list[str],
        "weights_sha256": list[str],
        "input": ExportedInput,
        "outputs": ExportedOutputs,
        "onnx": dict[str, Any] | None,
        "largest_difference": dict[str, float],
        "largest_difference_allowed": float,
        "contract": Contract,
    },
)


class ExportedLatency(TypedDict):
    """latency.json of an export: milliseconds of a pass, by program and number of images."""

    machine: dict[str, Any]
    versions: dict[str, str]
    threads: int
    numerics: str
    milliseconds: dict[str, dict[str, Spread]]


#: What stands at `request` and `answer` of an entry of each kind; of the others any JSON.
ASKED: dict[str, tuple[Any, Any]] = {
    "completions": (Request, Completion),
    "answers": (Extracted, Sources),
    "probes": (Probed, Profiles),
    "evaluations": (Trained, Trainings),
    "studies": (Trained, FullTrainings),
    "arrays": (_Question, _Content),
    "centroids": (Shape, list[list[float]]),
    "decisions": (Decision, Any),
    CANDIDATES: (File, Text),
}


class _Commented(GenerateJsonSchema):
    """Makes schemas with the comments of the records' fields, and without titles that repeat their names."""

    def dataclass_schema(self, schema: core_schema.DataclassSchema) -> dict[str, Any]:
        made = super().dataclass_schema(schema)
        for kind in schema["cls"].__mro__:
            for name, words in comments_of(kind).items() if is_dataclass(kind) else ():
                if words and name in made["properties"]:
                    made["properties"][name].setdefault("description", words)
        return made

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def schema_of(kind: Any) -> dict[str, Any]:
    """Return the schema of a record, or of a union of such."""
    return TypeAdapter(kind).json_schema(schema_generator=_Commented)


def lines_of(*kinds: type) -> dict[str, Any]:
    """Return the schema of a line of a ledger: that of a record, with its kind and both hashes."""
    union: Any = kinds[0]
    for kind in kinds[1:]:
        union |= kind
    made = schema_of(union)
    for kind in kinds:
        line = made["$defs"][kind.__name__]
        line["properties"] |= {"previous": {**_HASH, "description": "The hash of the line before."}}
        line["properties"] |= {"hash": {**_HASH, "description": "The hash of this line without this field."}}
        line["required"] = [*line["required"], "kind", "previous", "hash"]
    return made


def entries_of(record: type) -> dict[str, Any]:
    """Return the schema of an entry of the stores, with what is asked and answered by its kind."""
    made = schema_of(record)
    made["properties"]["kind"] = {"enum": [*KINDS, *([CANDIDATES] if record is Entry else [])]}
    shared: dict[str, Any] = {}
    cases = []
    for kind in made["properties"]["kind"]["enum"]:
        if kind in ASKED:
            parts = [schema_of(part) for part in ASKED[kind]]
            for part in parts:
                shared |= part.pop("$defs", {})
            then = {"properties": dict(zip(("request", "answer"), parts, strict=True))}
            cases.append({"if": {"properties": {"kind": {"const": kind}}}, "then": then})
    return {**made, "allOf": cases, "$defs": shared}


def packed() -> dict[str, Any]:
    """Return the schema of a line of store.jsonl.xz: its header, or an entry."""
    entry = entries_of(Entry)
    return {"$defs": entry.pop("$defs"), "if": {"required": ["entries"]}, "then": schema_of(_Header), "else": entry}


#: The schemas by their file: what it is of, and the schema.
SCHEMAS: dict[str, tuple[str, Any]] = {
    "run": ("run.json of a run", lambda: schema_of(RunRecord)),
    "ledger": ("a line of ledger.jsonl of a run", lambda: lines_of(RunLine, CandidateLine, GenerationLine)),
    "archive": ("archive.json of a run", lambda: schema_of(NetworkArchiveFile)),
    "prompts": ("prompts.json of a run", lambda: schema_of(PromptFile)),
    "timings": ("a line of timings.jsonl of a run", lambda: schema_of(Timing)),
    "study": ("study.json of a study, a noise run or a choice", lambda: schema_of(StudyRecord)),
    "scores": ("a line of scores.jsonl of such", lambda: lines_of(StudyHeader, ScoreLine, FailedLine)),
    "sweep": ("sweep.json of a sweep", lambda: schema_of(SweepRecord)),
    "failed": ("failed/NAME.json of a sweep", lambda: schema_of(Failure)),
    "plan": ("plan.json of a study or a sweep", lambda: schema_of(SeedPlan)),
    "entry": ("the file of an entry of the stores", lambda: entries_of(_Sealed)),
    "packed": ("a line of store.jsonl.xz of a bundle", packed),
    "table": ("table.json of the table of a space", lambda: schema_of(Header)),
    "networks": ("a line of networks.jsonl of such a table", lambda: schema_of(TableNetwork)),
    "trainings": ("a line of trainings.jsonl of such a table", lambda: schema_of(TableTraining)),
    "export_run": ("run.json of an export", lambda: schema_of(ExportedRun)),
    "export_config": ("config.json of an export", lambda: schema_of(ExportedConfig)),
    "export_latency": ("latency.json of an export", lambda: schema_of(ExportedLatency)),
    "part": ("config.code.NAME in run.json, of a part that decided", lambda: schema_of(PartCode)),
}


def texts() -> Iterator[tuple[str, str]]:
    """Yield the name and the text of every file."""
    for name, (what, make) in SCHEMAS.items():
        head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"Format 1: {what}"}
        made = {key: value for key, value in make().items() if key != "title"}
        yield f"{name}.json", json.dumps({**head, **made}, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in texts():
        (folder / file).write_text(text, encoding="utf-8")
