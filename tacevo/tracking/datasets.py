"""A run's data set and code as MLflow's pages show them: pure functions from run.json to texts."""

import json
from collections.abc import Mapping
from dataclasses import dataclass

from tacevo.records import Json, Kind
from tacevo.redaction import without_password

#: The longest digest that MLflow keeps, in characters.
_DIGEST = 36

#: What makes simulated images; without a commit, because the runs of several share one data set in MLflow.
_SIMULATION = {"mlflow.source.name": "tacevo data simulate", "mlflow.source.type": "LOCAL"}


@dataclass(frozen=True, slots=True, kw_only=True)
class DataSet:
    """A data set in the fields of MLflow's entity; `source`, `schema` and `profile` are JSON."""

    name: str
    digest: str
    source_type: str
    source: str
    schema: str
    profile: str


def source_tags(run: Mapping[str, Json]) -> dict[str, str]:
    """Return the tags by which MLflow shows the code of a run: the command, and the commit where one is recorded.

    Args:
        run: what run.json holds.
    """
    tags = {"mlflow.source.name": "tacevo search", "mlflow.source.type": "LOCAL"}
    code = run.get("code")
    if code is not None:
        tags |= {"mlflow.source.git.commit": code["commit"], "mlflow.source.git.dirty": json.dumps(code["dirty"])}
    return tags


def data_set(run: Mapping[str, Json]) -> DataSet:
    """Describe the data set of a run: images made here come from code, all others from `data.root`.

    The digest is the beginning of the fingerprint, as much as MLflow keeps; the profile has all of it, and how many
    images each part of the split has.

    Args:
        run: what run.json holds.
    """
    facts, chosen = run["data"], run["config"]["data"]
    is_simulated = chosen["source"] == "simulated"
    source = {"tags": _SIMULATION} if is_simulated else {"uri": without_password(chosen["root"] or "")}
    labels = facts["names"] if facts["kind"] == Kind.regression else ["class"]
    label_type = "float" if facts["kind"] == Kind.regression else "long"
    columns = [{"name": "image", "type": "binary"}, *({"name": name, "type": label_type} for name in labels)]
    training, validation, test = facts["counts"]
    profile = {
        "num_rows": training + validation + test,
        "training": training,
        "validation": validation,
        "test": test,
        "image_shape": [facts["in_channels"], facts["image_size"], facts["image_size"]],
        "fingerprint": facts["fingerprint"],
    }
    return DataSet(
        name=f"{run['task']['name']} ({chosen['source']})",
        digest=facts["fingerprint"][:_DIGEST],
        source_type="code" if is_simulated else "local",
        source=json.dumps(source),
        schema=json.dumps({"mlflow_colspec": columns}),
        profile=json.dumps(profile),
    )
