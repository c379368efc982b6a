"""What run.json says of a run, and its data set and code as MLflow's pages show them. Pure but for `read_facts`."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tacevo.errors import RunError
from tacevo.records import STRICT, DataFacts, Instruction, Json, Kind
from tacevo.storage.canonical import leaves
from tacevo.storage.run_directory import Code
from tacevo.typed import parse

#: The longest digest that MLflow keeps, in characters.
_DIGEST = 36

#: What makes simulated images; without a commit, because the runs of several share one data set in MLflow.
_SIMULATION = {"mlflow.source.name": "tacevo data simulate", "mlflow.source.type": "LOCAL"}

#: Settings that MLflow's pages show, or that say where they are.
_NEEDED = {"tracking.uri", "tracking.experiment", "data.source", "data.root"}

#: The mirror reads a part of run.json.
_PART = {**STRICT, "extra": "ignore"}


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskFacts:
    """The texts of a task that MLflow shows."""

    __pydantic_config__ = _PART

    name: str
    instructions: tuple[Instruction, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunFacts:
    """The part of run.json that MLflow shows."""

    __pydantic_config__ = _PART

    schema: Literal[1]
    config: dict[str, Json]
    task: TaskFacts
    data: DataFacts
    #: None of a run without a checkout, or of an earlier version.
    code: Code | None = None
    #: None of a run that is not finished.
    digest: str | None

    def settings(self) -> Mapping[str, Json]:
        """Return the configuration by full keys, as in `llm.model`."""
        return dict(leaves(self.config))


def read_facts(run_dir: Path) -> RunFacts:
    """Read run.json.

    Raises:
        RunError: it is missing or damaged.
    """
    path = run_dir / "run.json"
    try:
        text = path.read_bytes()
    except FileNotFoundError as error:
        raise RunError("a directory without run.json", place=str(run_dir), expected="a run directory") from error
    facts = parse(RunFacts, text, place=str(path), error=RunError, remedy="the file is damaged: restore it")
    if missing := sorted(_NEEDED - facts.settings().keys()):
        raise RunError("nothing", place=f"{path}, config.{missing[0]}", expected="a value", remedy="restore the file")
    return facts


@dataclass(frozen=True, slots=True, kw_only=True)
class DataSet:
    """A data set in the fields of MLflow's entity; `source`, `schema` and `profile` are JSON."""

    name: str
    digest: str
    source_type: str
    source: str
    schema: str
    profile: str


def source_tags(code: Code | None) -> dict[str, str]:
    """Return the tags by which MLflow shows the code of a run: the command, and the commit where one is recorded."""
    tags = {"mlflow.source.name": "tacevo search", "mlflow.source.type": "LOCAL"}
    if code is not None:
        tags |= {"mlflow.source.git.commit": code.commit, "mlflow.source.git.dirty": json.dumps(code.dirty)}
    return tags


def data_set(run: RunFacts) -> DataSet:
    """Describe the data set of a run: images made here come from code, all others from `data.root`.

    The digest is the beginning of the fingerprint, as much as MLflow keeps; the profile has all of it, and how many
    images each part of the split has.
    """
    facts, settings = run.data, run.settings()
    is_simulated = settings["data.source"] == "simulated"
    source = {"tags": _SIMULATION} if is_simulated else {"uri": settings["data.root"] or ""}
    labels = facts.names if facts.kind is Kind.regression else ("class",)
    label_type = "float" if facts.kind is Kind.regression else "long"
    columns = [{"name": "image", "type": "binary"}, *({"name": name, "type": label_type} for name in labels)]
    training, validation, test = facts.counts
    profile = {
        "num_rows": training + validation + test,
        "training": training,
        "validation": validation,
        "test": test,
        "image_shape": [facts.in_channels, facts.image_size, facts.image_size],
        "fingerprint": facts.fingerprint,
    }
    return DataSet(
        name=f"{run.task.name} ({settings['data.source']})",
        digest=facts.fingerprint[:_DIGEST],
        source_type="code" if is_simulated else "local",
        source=json.dumps(source),
        schema=json.dumps({"mlflow_colspec": columns}),
        profile=json.dumps(profile),
    )
