"""An MLflow store: opened, its experiment and its runs found or created."""

import contextlib
import getpass
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from mlflow import MlflowClient
from mlflow.entities import LifecycleStage, Metric, Param, Run
from mlflow.exceptions import MlflowException

from tacevo.errors import RunError
from tacevo.storage.files import flock
from tacevo.tracking.params import Point

#: The tag by which MLflow nests runs.
PARENT_TAG = "mlflow.parentRunId"

#: The tag by which MLflow says who wrote a run.
USER_TAG = "mlflow.user"

#: The tag by which MLflow's pages open an experiment: on its runs, and not on the traces of an application.
_KIND = {"mlflow.experimentKind": "custom_model_development"}

# What MLflow takes in one batch: 100 params, 1,000 values in all.
_PARAMS_PER_BATCH = 100

_METRICS_PER_BATCH = 900

_SQLITE = "sqlite:///"


def find_or_create_run(client: MlflowClient, experiment: str, *, tag: str, key: str, name: str) -> Run:
    """Return the run of an experiment whose `tag` is `key`; a new one is called `name`."""
    known = next(tagged_runs(client, experiment, tag, key), None)
    return known or client.create_run(experiment, run_name=name, tags={tag: key, **user_tags()})


def user_tags() -> dict[str, str]:
    """Return the tag of who writes; none where this machine does not know the user."""
    with contextlib.suppress(OSError, KeyError, ImportError):  # of releases of Python
        return {USER_TAG: getpass.getuser()}
    return {}


def tagged_runs(client: MlflowClient, experiment: str, tag: str, value: str) -> Iterator[Run]:
    """Yield the runs of an experiment that have a tag; neither text may have quotes."""
    token = None
    while True:
        page = client.search_runs([experiment], f"tags.`{tag}` = '{value}'", page_token=token)
        yield from page
        token = page.token
        if not token:
            return


def log(client: MlflowClient, run: str, params: Mapping[str, str], measures: Sequence[Point]) -> None:
    """Write params and metrics of a run, in as few requests as MLflow allows."""
    now = time.time_ns() // 1_000_000
    metrics = [Metric(key, value, now, step) for key, value, step in measures]
    texts = [Param(key, params[key]) for key in sorted(params)]
    while metrics or texts:
        client.log_batch(run, metrics[:_METRICS_PER_BATCH], texts[:_PARAMS_PER_BATCH])
        metrics, texts = metrics[_METRICS_PER_BATCH:], texts[_PARAMS_PER_BATCH:]


def open_store(uri: str) -> MlflowClient:
    """Open a store; a SQLite database and its directory are created where they are missing.

    Raises:
        OSError: the directory cannot be created. (MLflow itself would try for two minutes.)
        MlflowException: the store cannot be opened.
    """
    database = _database(uri)
    if database is not None:
        database.parent.mkdir(parents=True, exist_ok=True)
        _create(database)
    return MlflowClient(uri)


def find_or_create_experiment(client: MlflowClient, name: str) -> str:
    """Return the id of an experiment; a new one in a SQLite store keeps its artifacts beside the database.

    Raises:
        RunError: it was deleted, which in MLflow hides it and keeps its name.
        MlflowException: it cannot be created.
    """
    known = client.get_experiment_by_name(name)
    if known is not None:
        if known.lifecycle_stage != LifecycleStage.ACTIVE:
            raise RunError(
                "one that was deleted",
                place=f"MLflow experiment {name}",
                expected="an active one",
                remedy=f"restore it (`mlflow experiments restore --experiment-id {known.experiment_id}`), then "
                "`tacevo track` writes what is missing; or set tracking.experiment=NAME",
            )
    else:
        database = _database(client.tracking_uri)  # any other store knows its own place
        place = None if database is None else (database.parent / "mlartifacts").as_uri()
        try:
            return client.create_experiment(name, artifact_location=place, tags=_KIND)
        except MlflowException:
            known = client.get_experiment_by_name(name)  # the mirror of another search may have created it
            if known is None:
                raise
    return str(known.experiment_id)


def _create(database: Path) -> None:
    """Create a missing database under a hidden name, and then rename it.

    MLflow creates its tables in dozens of steps. A mirror that is killed among them would leave a database that MLflow
    can neither use nor repair; so it leaves a hidden file, which the next mirror replaces.
    """
    part = database.with_name(f".{database.name}.part")
    if database.exists() and not part.exists():
        return
    with part.open("ab") as file:
        flock(file.fileno(), wait=True)  # another mirror may be creating it
        if database.exists():
            part.unlink(missing_ok=True)
            return
        file.truncate(0)
        part.with_name(f"{part.name}-journal").unlink(missing_ok=True)
        MlflowClient(f"{_SQLITE}{part}")
        part.rename(database)


def _database(uri: str) -> Path | None:
    if not uri.startswith(_SQLITE):
        return None
    return Path(uri.removeprefix(_SQLITE).split("?")[0]).resolve()
