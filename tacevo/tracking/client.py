"""Runs of an MLflow store: found by what they are tagged with, nested, and each of them once."""

import fcntl
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from mlflow import MlflowClient
from mlflow.entities import Metric, Param, Run
from mlflow.exceptions import MlflowException

from tacevo.errors import RunError
from tacevo.tracking.entries import Measure

#: The tag by which MLflow nests runs.
PARENT_TAG = "mlflow.parentRunId"

# What MLflow takes in one batch: 100 params, 1,000 values in all.
_PARAMS_PER_BATCH = 100

_METRICS_PER_BATCH = 900


def all_runs(client: MlflowClient, experiment: str, wanted: str) -> list[Run]:
    """Give every run that MLflow's filter lets through, the oldest first, and always in the same order."""
    runs: list[Run] = []
    token = None
    while True:
        page = client.search_runs([experiment], wanted, page_token=token)
        runs.extend(page)
        token = page.token
        if not token:
            return sorted(runs, key=lambda run: (run.info.start_time, run.info.run_id))


def nested(client: MlflowClient, experiment: str, parent: str) -> list[Run]:
    """Give the runs directly below another."""
    return all_runs(client, experiment, tagged(PARENT_TAG, parent))


def tagged(tag: str, value: str) -> str:
    """Write the filter of runs with a tag; neither text may have quotes."""
    return f"tags.`{tag}` = '{value}'"


def claim(client: MlflowClient, experiment: str, *, tag: str, key: str, name: str) -> Run:
    """Give the one run with a tag, made where there is none.

    Where a server is killed before it answers, the client asks again, and two runs are made of one request; so are they
    by two machines that ask at once. The oldest stays, what is nested under the others comes to it, and the others go.

    Args:
        client: the store.
        experiment: the experiment's id.
        tag: the tag.
        key: its value.
        name: what a new run is called.
    """
    wanted = tagged(tag, key)
    found = all_runs(client, experiment, wanted)
    if not found:
        client.create_run(experiment, run_name=name, tags={tag: key})
        found = all_runs(client, experiment, wanted)
    kept, *others = found
    for other in others:
        for run in nested(client, experiment, other.info.run_id):
            client.set_tag(run.info.run_id, PARENT_TAG, kept.info.run_id)
        client.delete_run(other.info.run_id)
    return kept


def label(client: MlflowClient, run: Run, tags: Mapping[str, str]) -> None:
    """Set the tags that a run does not have yet."""
    for tag, value in tags.items():
        if run.data.tags.get(tag) != value:
            client.set_tag(run.info.run_id, tag, value)


def unlabel(client: MlflowClient, run: str, tag: str) -> None:
    """Take a tag from a run; that it is gone already, by a request whose answer was lost, is no error."""
    try:
        client.delete_tag(run, tag)
    except MlflowException as error:
        if error.error_code != "RESOURCE_DOES_NOT_EXIST":
            raise


def log(client: MlflowClient, run: str, params: Mapping[str, str], measures: Sequence[Measure]) -> None:
    """Write params and metrics of a run, in as few requests as MLflow allows."""
    now = time.time_ns() // 1_000_000
    metrics = [Metric(measure.key, measure.value, now, measure.step) for measure in measures]
    texts = [Param(key, params[key]) for key in sorted(params)]
    while metrics or texts:
        client.log_batch(run, metrics[:_METRICS_PER_BATCH], texts[:_PARAMS_PER_BATCH])
        metrics, texts = metrics[_METRICS_PER_BATCH:], texts[_PARAMS_PER_BATCH:]


_SQLITE = "sqlite:///"

#: What every SQLite database begins with; one in which nothing was made yet may be empty.
_MAGIC = b"SQLite format 3\0"


def open_store(uri: str) -> MlflowClient:
    """Open a store; a SQLite database and its folder are made where they are missing.

    Raises:
        RunError: the file is no SQLite database. (MLflow itself would try for two minutes before it said so.)
        OSError: the folder cannot be made. (Likewise.)
        MlflowException: the store cannot be opened.
    """
    database = _database(uri)
    if database is not None:
        database.parent.mkdir(parents=True, exist_ok=True)
        _make(database)
        _check(database)
    return MlflowClient(uri)


def find_or_create_experiment(client: MlflowClient, name: str) -> str:
    """Give the id of an experiment; a new one in a SQLite store keeps its artifacts beside the database."""
    found = client.get_experiment_by_name(name)
    if found is not None:
        return str(found.experiment_id)
    try:
        return client.create_experiment(name, artifact_location=_artifact_location(client.tracking_uri))
    except MlflowException:
        found = client.get_experiment_by_name(name)  # another search's mirror may have been quicker
        if found is None:
            raise
        return str(found.experiment_id)


def _make(database: Path) -> None:
    """Make a database that is missing out of sight, and then give it its name.

    MLflow creates its tables by dozens of steps. A mirror killed among them would leave a database that MLflow can
    neither use nor mend; so it leaves a hidden file, which the next mirror begins anew.
    """
    part = database.with_name(f".{database.name}.part")
    if database.exists() and not part.exists():
        return
    with part.open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # another mirror may be making it
        if database.exists():
            part.unlink(missing_ok=True)
            return
        file.truncate(0)
        part.with_name(f"{part.name}-journal").unlink(missing_ok=True)
        MlflowClient(f"{_SQLITE}{part}")
        part.rename(database)


def _check(database: Path) -> None:
    with database.open("rb") as file:
        start = file.read(len(_MAGIC))
    if start not in {b"", _MAGIC}:
        raise RunError(f"{database} is no SQLite database: it begins with {start!r}; name another, or a new one")


def _artifact_location(uri: str) -> str | None:
    """Name the folder beside a SQLite database; any other store knows its own place."""
    database = _database(uri)
    return None if database is None else (database.parent / "mlartifacts").as_uri()


def _database(uri: str) -> Path | None:
    if not uri.startswith(_SQLITE):
        return None
    return Path(uri.removeprefix(_SQLITE).split("?")[0]).resolve()
