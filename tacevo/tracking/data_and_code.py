"""A run's data set and code as MLflow's pages show them; pure."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import AliasPath, Field

from tacevo.environment import Code
from tacevo.errors import RunError
from tacevo.parts.facts import source_facts
from tacevo.records import STRICT, Json
from tacevo.storage.run_directory import RunRecord
from tacevo.typed import convert

#: The longest digest that MLflow keeps, in characters.
_DIGEST = 36

#: What makes simulated images; without a commit, because the runs of several share one data set in MLflow.
_SIMULATION = {"mlflow.source.name": "tacevo data simulate", "mlflow.source.type": "LOCAL"}

#: The mirror reads a part of the configuration.
_PART = {**STRICT, "extra": "ignore"}


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSettings:
    """The settings of a run that the mirror acts on, out of its whole configuration."""

    __pydantic_config__ = _PART

    source: Annotated[str, Field(validation_alias=AliasPath("data", "source"))]
    root: Annotated[str | None, Field(validation_alias=AliasPath("data", "root"))]
    uri: Annotated[str, Field(validation_alias=AliasPath("tracking", "uri"))]
    experiment: Annotated[str, Field(validation_alias=AliasPath("tracking", "experiment"))]


def read_settings(run: RunRecord, place: str = "run.json") -> RunSettings:
    """Read the settings that the mirror acts on.

    Raises:
        RunError: the configuration lacks one.
    """
    return convert(RunSettings, run.config, place=f"{place}, config", error=RunError, remedy="restore the file")


def source_tags(code: Code | None) -> dict[str, str]:
    """Return the tags by which MLflow shows the code of a run: the command, and the commit where one is recorded."""
    tags = {"mlflow.source.name": "tacevo search", "mlflow.source.type": "LOCAL"}
    if code is not None:
        tags |= {"mlflow.source.git.commit": code.commit, "mlflow.source.git.dirty": json.dumps(code.dirty)}
    return tags


def shown_config(run: RunRecord) -> dict[str, Json]:
    """Return a run's configuration as MLflow shows it: its model is called by the label, if it has one."""
    config, llm = dict(run.config), run.config.get("llm")
    if isinstance(llm, Mapping) and llm.get("label"):
        config["llm"] = {**llm, "model": llm["label"]}
    return config


def search_tags(run: RunRecord) -> dict[str, str]:
    """Return the tags by which searches are found: task, and what answered, unless the networks were given."""
    llm = shown_config(run).get("llm", {})
    asked = llm if isinstance(llm, Mapping) and not run.task.given else {}
    answered = {f"tacevo.{key}": str(asked[key]) for key in ("provider", "model") if key in asked}
    return {"tacevo.task": run.task.name, **answered}


def data_set(run: RunRecord) -> dict[str, str]:
    """Name the data set of a run in the fields of MLflow's entity: images made here come from code, others from a root.

    The digest is the beginning of the fingerprint, as much as MLflow keeps.
    """
    origin = read_settings(run)
    is_simulated = source_facts(origin.source).is_made
    return {
        "name": f"{run.task.name} ({origin.source})",
        "digest": run.data.fingerprint[:_DIGEST],
        "source_type": "code" if is_simulated else "local",
        "source": json.dumps({"tags": _SIMULATION} if is_simulated else {"uri": origin.root or ""}),
    }
